"""A batch of environments with Gymnasium's vector interface; one compiled call steps all."""

from collections.abc import Mapping, Sequence
from numbers import Integral
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dynamics.description import validate
from dynamics.types import Array
from flexarm_env.arguments import whole_seed
from flexarm_env.compiled.outputs import BatchOutputs, masks
from flexarm_env.core import Core
from flexarm_env.env import (
    RENDER_MODES,
    CoreAttributes,
    check_render_mode,
    frames_per_second,
    observation_space,
)
from flexarm_env.observations import GOALS
from flexarm_env.rewards import goal_reward

Flags = NDArray[np.bool_]
_AUTORESET = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)


class FlexArmVectorEnv(CoreAttributes, gym.vector.VectorEnv[Any, Any, Any]):
    """N flexible arms with one task; environment i equals a `FlexArmEnv` with seed `seed + i`.

    Keywords are those of `FlexArmEnv`, and `max_episode_steps`, `autoreset_mode`, `threads`.
    `render_mode` "human" shows the first environment.

    `gymnasium.make_vec` refuses `wrappers=` for this class, because they wrap single environments.
    Rewards and observations are keywords here (`reward=`, `obs=`), as fast as those of the id.
    Other changes go round the batch: `gymnasium.wrappers.vector.ClipReward(envs, 0.0, 1.0)`.
    Wrappers of single environments need `gym.make_vec(id, 8, vectorization_mode="sync",
    wrappers=[...])`, which steps one environment after another.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": list(RENDER_MODES),
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        check_render_mode(render_mode)
        known = {mode.value: mode for mode in _AUTORESET}
        given = getattr(autoreset_mode, "value", autoreset_mode)
        mode = known[validate.choice(given, "autoreset_mode", known)]
        steps = 0 if max_episode_steps is None else max_episode_steps
        self.core = Core(n_env=num_envs, single=False, max_steps=steps, **arguments)
        self.num_envs, self.render_mode, self.autoreset_mode = self.core.n_env, render_mode, mode
        self.metadata = {
            **self.metadata,
            "render_fps": frames_per_second(self.core),
            "autoreset_mode": mode,
        }
        self.single_observation_space = observation_space(self.core.layout)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (self.core.arm.n_torque,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._observed = self.core.layout.observed
        self._shape = (self.num_envs, self.core.arm.n_torque)
        self._all = np.arange(self.num_envs)
        self._pending = np.zeros(0, np.int64)  # environments to restart instead of stepping
        self._seeded = False

    # ---- for controllers -----------------------------------------------------------------------

    def joint_target(self) -> Array:
        """(num_envs, n_joint) [rad] joint angles of `FlexArmEnv.joint_target`."""
        return self.core.joint_target()

    def joint_state(self) -> tuple[Array, Array]:
        """(num_envs, n_joint) [rad] and [rad/s] joint angles and rates, as ideal encoders read."""
        return self.core.joint_state()

    # ---- the Gymnasium interface -------------------------------------------------------------

    def seed_streams(self, seed: int | Sequence[int | None] | None) -> None:
        """Seed the random streams as single environments with these seeds do."""
        if seed is None:
            if not self._seeded:
                for i in range(self.num_envs):
                    self.core.seed(i, self.np_random)
        else:
            for i, one in enumerate(self._seeds(seed)):
                if one is not None or not self._seeded:
                    self.core.seed(i, seeding.np_random(one)[0])
            if isinstance(seed, Integral):
                self._np_random, self._np_random_seed = seeding.np_random(int(seed))
        self._seeded = True

    def _seeds(self, seed: Any) -> list[int | None]:
        """One seed per environment."""
        if isinstance(seed, Integral):
            first = whole_seed(seed) or 0
            return [first + i for i in range(self.num_envs)]
        seeds = validate.sequence(seed, "seed")
        if len(seeds) != self.num_envs:
            raise ValueError(
                f"seed must hold {self.num_envs} seeds (one per environment), got {len(seeds)}."
            )
        return [whole_seed(one) for one in seeds]

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start episodes; environment i gets `seed + i` or `seed[i]`; options of `FlexArmEnv`."""
        self.core.claim()
        try:
            self.seed_streams(seed)
            out = self.core.reset(self._all, options)
            self._pending = self._pending[:0]
        finally:
            self.core.lock.release()
        if self._renderer is not None:
            self._renderer.clear()
        if self.render_mode == "human":
            self.render()
        return self._observed(out.obs), out.marked()

    def step(self, actions: Any) -> tuple[NDArray[np.float32], Array, Flags, Flags, dict[str, Any]]:
        """Advance all by one control step; ended episodes restart by `autoreset_mode`.

        Later steps do not overwrite a returned array while the caller keeps a reference to it.
        """
        array = self._actions(actions)
        self.core.claim()
        try:
            result = self._stepped(array)
        finally:
            self.core.lock.release()
        if self._renderer is not None:
            self._renderer.follow(self.core)
        if self.render_mode == "human":
            self.render()
        return result

    def _actions(self, actions: Any) -> NDArray[np.float32]:
        try:
            array = np.ascontiguousarray(actions, dtype=np.float32)
        except (TypeError, ValueError):
            raise ValueError(f"Actions must be numbers, got {validate.shown(actions)}.") from None
        if array.shape != self._shape:
            raise ValueError(f"Actions must have shape {self._shape}, got {array.shape}.")
        return array

    def _stepped(
        self, actions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], Array, Flags, Flags, dict[str, Any]]:
        out, ended = self.core.step(actions)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            return self._restart_now(out, ended)
        if self._pending.size:
            self.core.restart(self._pending, out)
            ended = True
        if ended:
            self._pending = np.flatnonzero(out.terminated | out.truncated)
        reward = self.rewarded(out)
        return self._observed(out.obs), reward, out.terminated, out.truncated, out.marked()

    def rewarded(self, out: BatchOutputs) -> Array:
        """(num_envs,) rewards: compiled, or with goals those of `compute_reward`."""
        if not self.core.layout.goal:
            return out.reward
        observation = self._observed(out.obs)
        reward = goal_reward(*(observation[name] for name in GOALS))
        return np.where(out.described()["time"] > 0.0, reward, 0.0)  # none at a reset

    def _restart_now(
        self, out: BatchOutputs, ended: int
    ) -> tuple[NDArray[np.float32], Array, Flags, Flags, dict[str, Any]]:
        """SAME_STEP: return the first observation of a new episode, with the last in final_obs."""
        outcome = self.rewarded(out), out.terminated, out.truncated
        final: dict[str, Any] = {}
        if ended:
            outcome = outcome[0].copy(), out.terminated.copy(), out.truncated.copy()
            done = out.terminated | out.truncated
            rows = np.flatnonzero(done)
            last = np.full(self.num_envs, None, dtype=object)
            for i in rows:
                last[i] = self._observed(out.obs[i].copy())
            final = {
                "final_obs": last,
                "_final_obs": done,
                "final_info": self._final_info(out, done),
                "_final_info": done.copy(),
            }
            self.core.restart(rows, out)
        return self._observed(out.obs), *outcome, out.marked() | final

    def _final_info(self, out: BatchOutputs, done: Flags) -> dict[str, Any]:
        """Copies of the info of this step, masked by `done`."""
        described = out.described()
        terms = described.pop("reward_terms")
        copies: dict[str, Any] = {name: values.copy() for name, values in described.items()}
        copies["reward_terms"] = {name: values.copy() for name, values in terms.items()}
        copies["reward_terms"] |= masks(terms, done)
        return copies | masks(copies, done)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture per environment, or show the first in a window and return None."""
        if self.render_mode is None:
            gym.logger.warn('render() needs render_mode="rgb_array" or "human" at construction.')
            return None
        from flexarm_env.rendering import Renderer

        if self._renderer is None:
            self._renderer = Renderer(self.core)
        if self.render_mode == "human":
            self._renderer.show(self._renderer.draw(self.core), self.core.control_dt)
            return None
        return tuple(self._renderer.draw(self.core, row) for row in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
