"""`perfbound init`: the first campaign file of a system."""
