"""A batch of environments with Gymnasium's vector interface: one compiled call steps them all."""

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
    check_render_mode,
    frames_per_second,
    observation_space,
)

Flags = NDArray[np.bool_]
_AUTORESET = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)


class FlexArmVectorEnv(gym.vector.VectorEnv[Any, Any, Any]):
    """N flexible arms at one task; environment i equals a single one seeded with `seed + i`.

    Keywords as of `FlexArmEnv`, and `max_episode_steps`, `autoreset_mode`, `threads`. Rendering
    shows the first environment.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": list(RENDER_MODES),
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    _renderer: Any = None  # here, so that closing after a refused construction finds it

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
        asked = getattr(autoreset_mode, "value", autoreset_mode)
        mode = known[validate.choice(asked, "autoreset_mode", known)]
        steps = 0 if max_episode_steps is None else max_episode_steps
        self.core = Core(n_env=num_envs, single=False, max_steps=steps, **arguments)
        self.num_envs, self.render_mode, self.autoreset_mode = self.core.n_env, render_mode, mode
        self.metadata = {
            **self.metadata,
            "render_fps": frames_per_second(self.core),
            "autoreset_mode": mode,
        }
        self.single_observation_space = observation_space(self.core.layout)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (self.core.arm.n_joint,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._shape = (self.num_envs, self.core.arm.n_joint)
        self._all = np.arange(self.num_envs)
        self._pending = np.zeros(0, np.int64)  # environments to restart instead of stepping
        self._seeded = False

    # ---- what agents ask ---------------------------------------------------------------------

    arm = property(lambda self: self.core.arm)
    model = property(lambda self: self.core.model)
    task = property(lambda self: self.core.task_name)
    control_dt = property(lambda self: self.core.control_dt)
    torque_limit = property(lambda self: self.core.torque_limit.copy())
    n_joint = property(lambda self: self.core.arm.n_joint)
    reach = property(lambda self: self.core.arm.reach)
    certificate = property(lambda self: self.core.certificate)
    observation_slices = property(lambda self: self.core.layout.slices)
    observation_scales = property(lambda self: self.core.layout.scales)

    def joint_target(self) -> Array:
        """(num_envs, n_joint) [rad] joint angles that put the tips on their targets."""
        return self.core.joint_target()

    def joint_state(self) -> tuple[Array, Array]:
        """(num_envs, n_joint) [rad] and [rad/s]: what ideal encoders read."""
        return self.core.joint_state()

    # ---- the Gymnasium interface -------------------------------------------------------------

    def seed_streams(self, seed: int | Sequence[int | None] | None) -> None:
        """Start random streams as single environments with these seeds would."""
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
        """One per environment."""
        if isinstance(seed, Integral):
            first = whole_seed(seed) or 0
            return [first + i for i in range(self.num_envs)]
        seeds = validate.sequence(seed, "seed")
        if len(seeds) != self.num_envs:
            raise ValueError(f"{self.num_envs} seeds are needed, got {len(seeds)}.")
        return [whole_seed(one) for one in seeds]

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """New episodes; env i gets `seed + i`, or `seed[i]`. Options as of `FlexArmEnv.reset`."""
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
        return out.obs, out.marked()

    def step(self, actions: Any) -> tuple[NDArray[np.float32], Array, Flags, Flags, dict[str, Any]]:
        """One control step of all; ended episodes restart as `autoreset_mode` says.

        What it returns stays as it is: arrays are filled again when nobody holds them any more.
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
        return out.obs, out.reward, out.terminated, out.truncated, out.marked()

    def _restart_now(
        self, out: BatchOutputs, ended: int
    ) -> tuple[NDArray[np.float32], Array, Flags, Flags, dict[str, Any]]:
        """SAME_STEP: the observation is the new episode's first, the last is in final_obs."""
        outcome = out.reward, out.terminated, out.truncated
        final: dict[str, Any] = {}
        if ended:
            outcome = out.reward.copy(), out.terminated.copy(), out.truncated.copy()
            done = out.terminated | out.truncated
            rows = np.flatnonzero(done)
            last = np.full(self.num_envs, None, dtype=object)
            for i in rows:
                last[i] = out.obs[i].copy()
            final = {
                "final_obs": last,
                "_final_obs": done,
                "final_info": self._final_info(out, done),
                "_final_info": done.copy(),
            }
            self.core.restart(rows, out)
        return out.obs, *outcome, out.marked() | final

    def _final_info(self, out: BatchOutputs, done: Flags) -> dict[str, Any]:
        """Copies of the last info of the environments that are `done`."""
        described = out.described()
        terms = described.pop("reward_terms")
        copies: dict[str, Any] = {name: values.copy() for name, values in described.items()}
        copies["reward_terms"] = {name: values.copy() for name, values in terms.items()}
        copies["reward_terms"] |= masks(terms, done)
        return copies | masks(copies, done)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Pictures of the environments in rgb_array mode; a window with the first in human mode."""
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

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}
