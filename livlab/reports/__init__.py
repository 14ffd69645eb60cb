"""Reports read run folders; they never simulate."""
