"""Files of a training run: its folder, log and checkpoints, and the callback that writes them."""
