"""The live page: a read-only server in a separate process."""
