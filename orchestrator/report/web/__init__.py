"""The live page: a read-only server in a process of its own."""
