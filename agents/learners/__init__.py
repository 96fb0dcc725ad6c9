"""Learners of stable-baselines3 and sb3-contrib: their names and settings, and their actors."""
