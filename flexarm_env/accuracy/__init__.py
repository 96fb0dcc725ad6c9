"""Measured errors of the environments; choice of model, integrator and step."""
