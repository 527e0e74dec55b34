"""Before a campaign: `init`, `calibrate`, `check-system` and `plan`, each whole in one folder."""
