"""Replay of one recorded rollout: simulated again, compared with its file, and drawn."""
