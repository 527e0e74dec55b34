"""Tests that can refute an assumption or a bound, each at its own level."""
