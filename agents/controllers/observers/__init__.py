"""Observers: estimates of the arm's state, from exact states or from sensors."""
