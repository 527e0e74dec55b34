"""The orchestrator: owns the campaign, dispatches rollouts to workers and issues the certificate."""
