"""What the tissue is: elements, layers, states, readings. NumPy and SciPy only, no renderer."""
