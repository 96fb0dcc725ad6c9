"""One file per preset arm: its ARM, sources and CHECKS."""
