"""From the facts of a campaign to the data of its report."""
