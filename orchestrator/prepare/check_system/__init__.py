"""`check-system`: its rollouts, and the findings from their measurements; pure functions."""
