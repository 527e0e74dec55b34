"""Constants of a kernel from a few values of the objective: fit, checks of the fit, and the evidence behind each."""
