"""Pictures of a campaign: the report of a finished one and the live page of a running one, from one story."""
