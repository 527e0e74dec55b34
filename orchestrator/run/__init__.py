"""One run of an orchestrator: its loop, its clock, its signals, and everything opened around them."""
