"""How many simulations searches for a failure need on the benchmarks of the ARCH-COMP falsification competition."""
