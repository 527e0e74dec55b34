"""Everything that survives a crash: the database of facts, the trajectory files, the lock."""
