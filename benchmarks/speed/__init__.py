"""Rates, costs and counts of the steppers, on processors and on a GPU."""
