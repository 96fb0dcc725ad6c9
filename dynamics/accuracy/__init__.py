"""Errors of models against the nonlinear beam, and models chosen by their error."""
