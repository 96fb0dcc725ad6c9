"""The leaderboard: tasks and tracks, shipped policies, ranking."""
