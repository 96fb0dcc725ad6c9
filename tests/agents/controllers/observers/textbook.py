"""The Kalman filter of textbooks, of late readings, in plain NumPy."""

from typing import Any

import numpy as np
from scipy.linalg import block_diag

from agents.controllers.models.linear_model import LinearModel
from dynamics.types import Array


def filtered(
    model: LinearModel, filters: Any, vibration: Array, readings: Array, torques: Array, delay: int
) -> tuple[Array, float, Array]:
    """State with the gauges' biases at the latest reading, its surprise, and the present state.

    Readings (T, y) before the delay repeat the first; `vibration` is the covariance at the start.
    """
    sensors, m, r = filters.sensors, len(filters.limit), len(model.modes)
    biases = len(sensors.bias)
    A = block_diag(model.A, np.eye(biases))
    B = np.vstack([model.B, np.zeros((biases, m))])
    C, D = np.hstack([model.C, np.eye(m + biases)[:, m:]]), model.D
    Q = np.diag((filters.disturbance * filters.limit) ** 2)
    W, both, V = B @ Q @ B.T, B @ Q @ D.T, D @ Q @ D.T + np.diag(sensors.noise**2)
    W += 1e-12 * np.trace(W) / len(W) * np.eye(len(W))
    x, surprise = np.zeros(len(A)), 0.0
    x[:r] = model.modes[:, filters.models.joints] @ readings[0][:m]
    P = block_diag(vibration, np.diag(sensors.bias**2)) + W
    for k in [0, *range(delay + 1, len(readings))]:
        held = torques[k - delay - 1] if k else np.zeros(m)
        if k:
            x, P = A @ x + B @ held, A @ P @ A.T + W
        gap = readings[k] - C @ x - D @ held
        S = C @ P @ C.T + C @ both + both.T @ C.T + V
        surprise += gap @ np.linalg.solve(S, gap)
        surprise += np.linalg.slogdet(2.0 * np.pi * S)[1] - 2.0 * np.log(sensors.quantum).sum()
        gain = np.linalg.solve(S, C @ P + both.T).T
        x, P = x + gain @ gap, P - gain @ S @ gain.T
    now = x
    for torque in torques[len(readings) - 1 - delay :]:
        now = A @ now + B @ torque
    return x, float(surprise), now[: 2 * r]
