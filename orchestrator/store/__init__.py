"""What outlives a crash: the journal of facts, the evidence files, the lock."""
