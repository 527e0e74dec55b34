"""Signal temporal logic: text to tree, tree and trajectory to robustness."""
