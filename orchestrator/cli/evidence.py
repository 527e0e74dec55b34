"""Commands about what a campaign leaves behind: verify it, sign it, export it."""
