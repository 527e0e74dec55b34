"""The bounds: from observations to bounds, from bounds to claims, and the audit of their assumptions."""
