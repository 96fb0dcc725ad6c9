"""Published numbers compared with ours, with verdicts."""
