"""Bounds from observations, their composition, and the audit of their assumptions."""
