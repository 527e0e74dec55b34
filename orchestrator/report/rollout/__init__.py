"""Single rollouts: curves, robustness over time, a picture, a replay beside another one."""
