"""The live page of a run: its address, who may see it, and what its process is fed with."""
