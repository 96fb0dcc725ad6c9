"""Search over an experiment's agent keywords with Ray Tune, on one machine or a cluster."""
