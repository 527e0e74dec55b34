"""Simulators of others as systems without a line of code: what a campaign file says of them becomes a specification."""
