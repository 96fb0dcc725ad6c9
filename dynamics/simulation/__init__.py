"""Motions of compiled arms: one arm through time, or a batch step by step."""
