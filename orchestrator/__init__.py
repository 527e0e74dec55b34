"""The orchestrator: it owns the campaign, dispatches rollouts to workers and issues the certificate."""
