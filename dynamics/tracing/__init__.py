"""Expression graphs of one arm, and straight-line functions made of them."""
