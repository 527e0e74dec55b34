"""Random numbers of a campaign: uniform ones by a counter, and the inverse transform to distributions and laws."""
