"""Method `kriging`: noisy rollouts at the starts of a design, and weighted sums of them that bound every mean."""
