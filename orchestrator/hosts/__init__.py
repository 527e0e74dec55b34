"""Files for the machines of a campaign: a certificate authority with its keys, and jobs for Slurm."""
