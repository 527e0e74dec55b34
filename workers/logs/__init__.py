"""Logs of others, of a rig or a vehicle: tables and messages as the columns of a system."""
