"""Trainings of experiments: scores beside joint PD and experts, and their cost."""
