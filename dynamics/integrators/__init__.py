"""Integration methods as plain functions, one table."""
