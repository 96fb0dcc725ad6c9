"""Tasks: references, rewards, observations, and the scales that follow from the arm."""
