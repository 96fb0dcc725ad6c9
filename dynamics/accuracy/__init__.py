"""Tip errors of models against the nonlinear beam, and the choice of a model by its error."""
