"""The coverage study: how often bounds fail, over thousands of simulated campaigns with a known truth."""
