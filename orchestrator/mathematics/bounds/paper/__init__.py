"""Method `paper`: Algorithm 1 of [ARA] as printed, and its formulas."""
