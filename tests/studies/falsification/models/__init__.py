"""Models of the competition, written from their published equations; one module each, numpy and standard library."""
