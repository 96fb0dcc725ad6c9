"""Random policies of every kind that a run folder can hold, and their torques in Python."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from agents.export.signals import Signals, signals_of
from agents.metrics import make_batch
from agents.policy import GATES, Normalization, Policy
from dynamics.types import AnyArray

ENV_ID = "FlexArm/OneLink-Reach-v0"
STEPS, RESTART = 60, 40  # control steps, and the one at which a second episode begins
ROUND_OFF = 1e-6  # [-] of actions: sums in float32 in another order
KINDS: dict[str, dict[str, Any]] = {
    "tanh": {},
    "relu": {"activation": "relu"},
    "elu": {"activation": "elu", "squashing": "tanh", "mean_limit": 0.5},
    "stacked": {"stack": 12},
    "normalized": {"normalized": True, "stack": 3},
    "recurrent": {"recurrent": 1},
    "recurrent-stacked": {"recurrent": 2, "stack": 2, "normalized": True},
}


@cache
def laboratory() -> Any:
    """Core of the environment with sensors."""
    return make_batch(ENV_ID, 1, {"hardware": "laboratory"}).unwrapped.core


def policy_of(kind: str) -> Policy:
    """A random policy, with weights as large as those of trained ones."""
    given = {"recurrent": 0, "stack": 1, "normalized": False} | KINDS[kind]
    rng, n_in = np.random.default_rng(0), laboratory().layout.size
    weights, biases, size = [], [], n_in * given["stack"]
    for i in range(given["recurrent"]):
        n = (12, 16)[i]
        weights.append(rng.normal(size=(GATES * n, size + n)) / np.sqrt(n))
        biases.append(rng.normal(size=GATES * n))
        size = n
    for n in (64, 64, 1):
        weights.append(rng.normal(size=(n, size)) / np.sqrt(size))
        biases.append(0.1 * rng.normal(size=n))
        size = n
    statistics = Normalization(
        mean=rng.normal(size=n_in), variance=rng.uniform(0.1, 4.0, n_in), epsilon=1e-8, clip=1.5
    )
    return Policy(
        weights=tuple(W.astype(np.float32) for W in weights),
        biases=tuple(b.astype(np.float32) for b in biases),
        recurrent=given["recurrent"],
        activation=given.get("activation", "tanh"),
        squashing=given.get("squashing", "clip"),
        mean_limit=given.get("mean_limit"),
        observation_low=np.full(n_in * given["stack"], -10.0, np.float32),
        observation_high=np.full(n_in * given["stack"], 10.0, np.float32),
        normalization=statistics if given["normalized"] else None,
        about={"stack": given["stack"], "env_id": ENV_ID}
        | {"env_kwargs": {"hardware": "laboratory"}, "config": "wi*/ld\\"},
    )


def signals(policy: Policy) -> Signals:
    return signals_of(policy, ENV_ID, laboratory())


def readings() -> AnyArray:
    """(STEPS, 3) joint error [rad] and rate [rad/s], curvature [1/m], some beyond their bounds."""
    rng = np.random.default_rng(1)
    scales = np.concatenate(list(laboratory().layout.scales.values()))[:-1]
    return scales * rng.normal(size=(STEPS, 3)) * rng.choice([0.3, 1.0, 8.0], size=(STEPS, 1))


def torques(policy: Policy) -> AnyArray:
    """(STEPS, 1) [N m] torques of the policy in Python, whose sums are in float64 here."""
    exact = (tuple(x.astype(np.float64) for x in y) for y in (policy.weights, policy.biases))
    policy = replace(policy, **dict(zip(("weights", "biases"), exact, strict=True)))
    layout, found = laboratory().layout, []
    state: Any = None
    for k, reading in enumerate(readings()):
        if k in (0, RESTART):
            state, action = None, np.zeros(1)
        elements = np.clip(
            np.append(reading, action) * layout.factors, -layout.bounds, layout.bounds
        )
        action, state = policy.predict(elements.astype(np.float32), state)
        found.append(action * laboratory().torque_limit)
    return np.array(found)
