"""What a campaign will probably prove, and with how many tests; no certificate depends on it."""
