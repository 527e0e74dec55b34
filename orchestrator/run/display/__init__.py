"""What a run shows while it goes on: a live table, lines, JSON, systemd, and what is known so far."""
