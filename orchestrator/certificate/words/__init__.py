"""A certificate in words: claims, bounds, regions, refutations, and what would help."""
