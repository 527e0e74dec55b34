"""The dispatch machine: which worker gets which rollout, retries, losses, blame; pure functions."""
