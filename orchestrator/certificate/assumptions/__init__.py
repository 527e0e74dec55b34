"""The assumptions of a claim: their status by the data, and their sentences."""
