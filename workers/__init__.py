"""Simulator workers: they know how to run the installed systems, and nothing of campaigns."""
