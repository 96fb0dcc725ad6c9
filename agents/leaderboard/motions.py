"""Motions of one episode under any actions, and their derivatives by every single action."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.leaderboard.tracks import TRACKS
from agents.metrics import HOLD, make_batch
from dynamics.load import load_arm
from dynamics.runtime.jit import aligned_zeros
from dynamics.types import Array
from flexarm_env import IDS
from flexarm_env.derivatives import Derivatives
from flexarm_env.hardware.sensors import load_hardware
from flexarm_env.task.tasks import SETTLED_BAND

MEMORY = ("q", "v", "actuator")  # rows of the state by which an action acts on later steps


@dataclass(frozen=True)
class Motion:
    """Actions and what they do in the environment."""

    actions: Array  # (T, m)
    errors: Array  # (T, k) [-] tip errors over the band, as observed
    distance: Array  # (T,) [-] their lengths, as judged
    deflection: Array  # (T,) [-] over its limit
    settled: int  # first step from which the tip stays in the band, T if none
    valid: bool  # the episode did not end early

    @property
    def rms(self) -> float:
        """Root mean square tip error over the band."""
        return float(np.sqrt(np.mean(self.distance**2)))


class Episode:
    """One episode, which may be repeated with any actions.

    `held` is the last of the motions' steps from which staying in the band counts as settling;
    `start` is the tip error at the start over the band.
    """

    def __init__(
        self, env_id: str, kwargs: Mapping[str, Any], seed: int, batches: dict[Any, Any]
    ) -> None:
        self.env_id, self.kwargs, self.seed = env_id, dict(kwargs), seed
        steps, self.dt = IDS[env_id]["max_episode_steps"], IDS[env_id]["kwargs"]["control_dt"]
        self.steps, self.held = steps, steps - 1 - math.ceil(HOLD / self.dt - 1e-9)
        self._batches = batches
        envs, _ = self.batch(1)
        base = envs.unwrapped
        self.reach = float(base.reach)
        self._errors = base.observation_slices["tip_error"]
        self._scale = base.observation_scales["tip_error"] / (SETTLED_BAND * self.reach)
        self._limit = base.core.arguments["deflection_limit"]
        _, info = envs.reset(seed=[seed])
        self.start = float(info["tip_error"][0]) / (SETTLED_BAND * self.reach)  # [-]

    def batch(self, n_env: int) -> Any:
        """A batch whose environments all have this episode."""
        if n_env not in self._batches:
            self._batches[n_env] = make_batch(self.env_id, n_env, self.kwargs)
        envs = self._batches[n_env]
        observation, _ = envs.reset(seed=[self.seed] * n_env)
        return envs, observation

    def follow(self, actions: Array) -> list[Motion]:
        """Motions under several sequences of actions (P, T, m)."""
        envs, _ = self.batch(len(actions))
        errors, deflection, distance, ended = [], [], [], np.zeros(len(actions), bool)
        for k in range(self.steps):
            observation, _, terminated, _, info = envs.step(actions[:, k].astype(np.float32))
            ended |= terminated
            errors.append(observation[:, self._errors] * self._scale)
            deflection.append(info["deflection"] / self._limit)
            distance.append(info["tip_error"] / (SETTLED_BAND * self.reach))
        outside = np.array(distance) >= 1.0
        last = np.where(outside.any(axis=0), self.steps - outside[::-1].argmax(axis=0), 0)
        columns = zip(
            actions, np.array(errors).transpose(1, 0, 2), np.array(distance).T,
            np.array(deflection).T, last.tolist(), ~ended, strict=True,
        )  # fmt: skip
        return [Motion(*column) for column in columns]

    def effects(self, motion: Motion) -> tuple[Array, Array]:
        """(T, k, T m) of the errors and (T, T m) of the deflection: slopes by every single action.

        Derivatives of every step by its memory and its action, chained from step to step.
        """
        (steps, m), each = motion.actions.shape, self._steps(motion)
        size = each.shape[2] - m
        memory = np.zeros((size, steps * m))
        found = np.zeros((steps, each.shape[1] - size, steps * m))
        for k, own in enumerate(each):
            earlier, now = slice(k * m), slice(k * m, (k + 1) * m)
            reached = own[:, :size] @ memory[:, earlier]
            memory[:, earlier], found[k, :, earlier] = reached[:size], reached[size:]
            memory[:, now], found[k, :, now] = own[:size, size:], own[size:, size:]
        return found[:, :-1], found[:, -1]

    def _steps(self, motion: Motion) -> Array:
        """(T, rows, columns) derivatives of every step, from one batch.

        Rows are the memory after it, errors and deflection; columns the memory before it and the
        action.
        """
        envs, _ = self.batch(1)
        core, actions, states = envs.unwrapped.core, motion.actions.astype(np.float32), []
        for action in actions:
            states.append(core.state[:, 0].copy())
            envs.step(action[None])
        memory = np.concatenate([np.r_[core.signals.state.slices[name]] for name in MEMORY])
        columns = len(memory) + actions.shape[1]
        step, unit = np.divmod(np.arange(self.steps * columns), columns)
        derivatives, shape = self._derivatives(step.size)
        state, along = aligned_zeros(shape, np.float64), aligned_zeros(shape, np.float64)
        state[:, : step.size], state[:, step.size :] = np.array(states)[step].T, states[0][:, None]
        directions = np.eye(columns)[unit]
        along[memory, : step.size] = directions[:, : len(memory)].T
        by = np.ascontiguousarray(directions[:, len(memory) :])
        found = derivatives.push_forward(state, actions[step].astype(np.float64), along, by)
        rows = np.concatenate([
            found.after[memory, : step.size],
            (found.obs[:, self._errors] * self._scale).T,
            found.info[core.signals.info.slices["deflection"], : step.size] / self._limit,
        ])  # fmt: skip
        return rows.reshape(-1, self.steps, columns).swapaxes(0, 1)

    def _derivatives(self, count: int) -> tuple[Derivatives, tuple[int, ...]]:
        """Derivatives of a batch, and the shape of its state."""
        if "derivatives" not in self._batches:
            core = make_batch(self.env_id, count, self.kwargs).unwrapped.core
            self._batches["derivatives"] = Derivatives(core), core.state.shape
        kept: tuple[Derivatives, tuple[int, ...]] = self._batches["derivatives"]
        return kept

    def acted(self, subject: Any) -> Array:
        """(T, m) actions of a controller in this episode."""
        envs, observation = self.batch(1)
        state, start, actions = None, np.ones(1, bool), []
        for _ in range(self.steps):
            action, state = subject.predict(observation, state, start)
            actions.append(np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)[0])
            observation, _, terminated, _, _ = envs.step(np.asarray(action, np.float32))
            start = terminated
        return np.array(actions)


def plant(env_id: str, track: str) -> dict[str, Any]:
    """Keywords of an environment with the plants of a track and an exact observation."""
    hardware = load_hardware(TRACKS[track].kwargs.get("hardware"))
    if hardware is None:
        return {"obs": "state"}
    return {"obs": "state", "randomize": hardware.spread(load_arm(IDS[env_id]["kwargs"]["arm"]))}
