"""What the method paper printed, regenerated from campaigns: which to run, their numbers, their figures."""
