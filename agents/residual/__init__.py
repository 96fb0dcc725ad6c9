"""Policies that correct a classical controller: its action plus theirs, scaled and clipped."""
