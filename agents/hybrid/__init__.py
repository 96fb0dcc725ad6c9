"""Policies on a classical controller: they correct its actions, or plan its reference."""
