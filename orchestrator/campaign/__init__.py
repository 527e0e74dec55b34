"""The decisions of a campaign, from its facts alone: tests, observations, bounds, stops."""
