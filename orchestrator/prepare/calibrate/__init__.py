"""`perfbound calibrate`: the constants of a kernel from rollouts, each with its reason, and a campaign file."""
