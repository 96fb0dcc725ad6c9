"""Named scenarios of the literature, followed and drawn."""
