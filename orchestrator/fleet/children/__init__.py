"""Child processes: local workers, single rollouts, and whatever they started."""
