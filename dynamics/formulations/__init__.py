"""Equations of motion of chains of flexible links, in three formulations."""
