"""The campaign file: its keys, their defaults and checks, and every fault of it in words."""
