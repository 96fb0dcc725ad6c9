"""Expression graphs of an arm, and the straight-line functions generated from them."""
