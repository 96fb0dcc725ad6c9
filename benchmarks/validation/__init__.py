"""Published numbers beside ours, with verdicts."""
