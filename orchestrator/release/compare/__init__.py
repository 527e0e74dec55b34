"""Is one of two systems worse? Rollouts of both in pairs, and what they show."""
