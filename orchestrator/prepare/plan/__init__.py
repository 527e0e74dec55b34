"""`perfbound plan`: what a campaign will need from a fleet, from a pilot."""
