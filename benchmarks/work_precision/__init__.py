"""Tip error against processor time of models, methods and steps."""
