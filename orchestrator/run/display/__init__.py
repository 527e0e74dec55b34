"""What a run shows before its end: a live table, lines, JSON, systemd, and what is known so far."""
