"""A safety case of a finished campaign: what is claimed, on what it rests, what was not checked, who signed."""
