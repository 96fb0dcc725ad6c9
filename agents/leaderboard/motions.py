"""Motions of one episode under any actions, and their slopes by every single action."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.leaderboard.tracks import TRACKS
from agents.metrics import HOLD, make_batch
from dynamics.load import load_arm
from dynamics.types import Array
from flexarm_env import IDS
from flexarm_env.hardware.sensors import load_hardware
from flexarm_env.task.tasks import SETTLED_BAND

NUDGE = 1e-3  # [-] change of an action for its effect


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
        self, env_id: str, kwargs: Mapping[str, Any], seed: int, batches: dict[int, Any]
    ) -> None:
        self.env_id, self.kwargs, self.seed = env_id, dict(kwargs), seed
        steps, self.dt = IDS[env_id]["max_episode_steps"], IDS[env_id]["kwargs"]["control_dt"]
        self.steps, self.held = steps, steps - 1 - math.ceil(HOLD / self.dt - 1e-9)
        self._batches = batches
        envs, _ = self.batch(1)
        self.reach = float(envs.unwrapped.reach)
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
        base = envs.unwrapped
        part = base.observation_slices["tip_error"]
        scale = base.observation_scales["tip_error"] / (SETTLED_BAND * base.reach)
        limit = base.core.arguments["deflection_limit"]
        errors, deflection, distance, ended = [], [], [], np.zeros(len(actions), bool)
        for k in range(self.steps):
            observation, _, terminated, _, info = envs.step(actions[:, k].astype(np.float32))
            ended |= terminated
            errors.append(observation[:, part] * scale)
            deflection.append(info["deflection"] / limit)
            distance.append(info["tip_error"] / (SETTLED_BAND * base.reach))
        outside = np.array(distance) >= 1.0
        last = np.where(outside.any(axis=0), self.steps - outside[::-1].argmax(axis=0), 0)
        columns = zip(
            actions, np.array(errors).transpose(1, 0, 2), np.array(distance).T,
            np.array(deflection).T, last.tolist(), ~ended, strict=True,
        )  # fmt: skip
        return [Motion(*column) for column in columns]

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


def effects(episode: Episode, motion: Motion) -> tuple[Array, Array]:
    """(T, k, T m) of the errors and (T, T m) of the deflection: slopes by every single action."""
    count = motion.actions.size
    nudged = np.tile(motion.actions, (count + 1, 1, 1)).reshape(count + 1, -1)
    sign = np.where(nudged[0] > 0.0, -NUDGE, NUDGE)
    nudged[np.arange(count), np.arange(count)] += sign
    found = episode.follow(nudged.reshape(count + 1, *motion.actions.shape))
    here = found[-1]
    slopes = [(x.errors - here.errors) / s for x, s in zip(found, sign, strict=False)]
    bends = [(x.deflection - here.deflection) / s for x, s in zip(found, sign, strict=False)]
    return np.stack(slopes, axis=-1), np.stack(bends, axis=-1)
