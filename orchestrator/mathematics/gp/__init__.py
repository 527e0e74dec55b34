"""Gaussian-process regression: kernel, candidates, observations, posterior, maximisers."""
