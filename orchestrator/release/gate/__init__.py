"""The gate: a policy, the certificates of finished campaigns, and whether each rule of the policy holds."""
