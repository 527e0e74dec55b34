"""The presentation of a campaign: its data, the page, figures, replay, and the tables of the paper."""
