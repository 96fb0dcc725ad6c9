"""Pages of the environments, and the code that they run."""
