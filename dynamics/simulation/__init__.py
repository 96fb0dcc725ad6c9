"""Simulation of compiled arms: one arm over time, or a batch step by step."""
