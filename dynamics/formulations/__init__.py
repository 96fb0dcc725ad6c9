"""Equations of motion of chains of flexible links."""
