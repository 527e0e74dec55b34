"""The failures of a campaign as regression tests: grouped, moved next to the border, and replayed against new code."""
