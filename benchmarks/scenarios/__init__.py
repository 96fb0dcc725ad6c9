"""Named scenarios of the literature, simulated and drawn."""
