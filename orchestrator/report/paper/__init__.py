"""The published results: their campaigns, table and figures, regenerated."""
