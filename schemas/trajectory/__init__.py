"""The trajectory of a rollout: its columns, its MCAP file, its canonical bytes, its scene."""
