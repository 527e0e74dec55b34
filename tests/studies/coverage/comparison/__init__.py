"""Comparisons of two systems, and what is usual in their place."""
