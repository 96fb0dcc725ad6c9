"""Integration methods as plain functions, and the table of them."""
