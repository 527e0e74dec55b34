"""Rollouts on record: what the Segway did when `segway.json` was written, and a test that it still does the same."""
