"""Arms from robots in the Unified Robot Description Format."""
