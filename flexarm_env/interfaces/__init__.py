"""Environments as Gymnasium, stable-baselines3 and torch take them."""
