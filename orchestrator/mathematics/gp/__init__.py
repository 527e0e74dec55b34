"""Gaussian-process regression on a lattice: kernel, candidates, posterior, acquisition."""
