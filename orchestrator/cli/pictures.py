"""Commands that draw: the report of a campaign, and its live page."""
