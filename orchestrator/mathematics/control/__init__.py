"""Controls with a known mean: what the declared disturbances of a rollout explain of its value."""
