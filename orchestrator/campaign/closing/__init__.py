"""The checks at the end of a campaign: fresh starts, the risk there, a nearer counterexample, the recheck."""
