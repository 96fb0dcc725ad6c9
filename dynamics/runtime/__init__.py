"""Compilation to disk, and threads that share a batch."""
