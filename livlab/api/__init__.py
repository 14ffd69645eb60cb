"""The notebook's surface: what `import livlab` offers by name. Beside the command line; adds no physics."""
