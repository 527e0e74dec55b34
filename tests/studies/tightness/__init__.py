"""The tightness study: how near to the truth bounds of the Segway's risk come with so many rollouts."""
