"""Compiled random numbers of sensors: hashes that depend neither on the batch nor on threads."""

import math

import numpy as np

from dynamics.runtime.jit import compiled


@compiled
def normal(key, step, k):  # type: ignore[no-untyped-def]
    """Number k of a step: mean 0, standard deviation 1 (a finaliser of splitmix64)."""
    z = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    z ^= (np.uint64(step) * np.uint64(256) + np.uint64(k)) * np.uint64(0xD1342543DE82EF95)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    low, mask = np.uint64(0), np.uint64(0xFFFF)
    for shift in range(4):
        low += (z >> np.uint64(16 * shift)) & mask
    return (np.float64(low) - 131070.0) * (math.sqrt(3.0) / 65536.0)
