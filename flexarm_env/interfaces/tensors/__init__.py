"""Batches whose observations, rewards and actions are torch tensors."""
