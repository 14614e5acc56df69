"""What the counts of a real rig's channels mean."""
