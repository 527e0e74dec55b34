"""Campaigns with declared disturbances: whatever a control makes of them, no bound may fail more often than stated."""
