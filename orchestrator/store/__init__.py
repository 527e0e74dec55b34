"""The parts of a campaign that survive a crash: the database of facts, the trajectory files, the lock."""
