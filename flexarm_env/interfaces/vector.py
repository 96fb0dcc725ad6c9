"""A batch of environments with Gymnasium's vector interface; one compiled call steps all."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Integral
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dynamics.description import validate
from dynamics.types import Array
from flexarm_env.arguments import episode_steps, plain, whole_seed
from flexarm_env.compiled.outputs import BatchOutputs, masks
from flexarm_env.core import Core
from flexarm_env.interfaces.env import (
    RENDER_MODES,
    CoreAttributes,
    check_keywords,
    check_render_mode,
    frames_per_second,
    observation_space,
    reset_needed,
)
from flexarm_env.task.observations import GOALS
from flexarm_env.task.rewards import goal_reward

Flags = NDArray[np.bool_]
OWN_KEYWORDS = ("num_envs", "max_episode_steps", "autoreset_mode", "render_mode")


class FlexArmVectorEnv(CoreAttributes, gym.vector.VectorEnv[Any, Any, Any]):
    """N flexible arms with one task; environment i equals a `FlexArmEnv` with seed `seed + i`.

    Keywords are those of `FlexArmEnv`, and `max_episode_steps`, `autoreset_mode`, `threads`. Of
    `max_episode_steps`, -1 is no limit, and None that of the id; without an id there is none.
    `render_mode` "human" shows the first environment. With `autoreset_mode` DISABLED the caller
    restarts ended episodes by `reset(options={"reset_mask": terminated | truncated})`.

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
        check_keywords(arguments, *OWN_KEYWORDS)
        known = {mode.value: mode for mode in AutoresetMode}
        given = getattr(autoreset_mode, "value", autoreset_mode)
        mode = known[validate.choice(given, "autoreset_mode", known)]
        steps = episode_steps(max_episode_steps)
        core = Core(n_env=num_envs, single=False, max_steps=steps, **arguments)
        self.num_envs, self.render_mode, self.autoreset_mode = core.n_env, render_mode, mode
        self.core = core
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
        self._pending = np.zeros(0, np.int64)  # ended environments, to restart before a step
        self._latest: NDArray[np.float32] | None = None  # observations, if the caller restarts
        self._seeded = False
        self._own_steps = 0  # of the id: the limit that max_episode_steps=None stands for

    @property
    def max_episode_steps(self) -> int:
        """Control steps after which an episode is truncated; -1: never."""
        return self.core.max_steps or -1

    @max_episode_steps.setter
    def max_episode_steps(self, given: int | None) -> None:
        self.core.change(max_steps=episode_steps(given, self._own_steps))

    @property
    def spec(self) -> Any:
        """Gymnasium's specification; its `max_episode_steps` is that of the construction."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        """Take the id's limit of steps where the keyword was None."""
        if given is None:
            self._spec = None
            return
        self._own_steps = given.max_episode_steps or 0
        if given.kwargs.get("max_episode_steps", 0) is None:
            self.core.change(max_steps=self._own_steps)
        steps = self.core.max_steps or None
        self._spec = replace(given, kwargs=plain(given.kwargs), max_episode_steps=steps)

    # ---- for controllers -----------------------------------------------------------------------

    def joint_target(self) -> Array:
        """(num_envs, n_joint) [rad] joint angles of `FlexArmEnv.joint_target`."""
        return self.core.joint_target()

    def joint_state(self) -> tuple[Array, Array]:
        """(num_envs, n_joint) [rad] and [rad/s] joint angles and rates, as ideal encoders read."""
        return self.core.joint_state()

    # ---- attributes, as of Gymnasium's SyncVectorEnv ---------------------------------------------

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Result of a method, or value of an attribute, for each environment.

        A result that has one row per environment is split; any other belongs to all of them.
        """
        if name in ("reset", "step"):
            raise ValueError(f"{name} is of the whole batch, not of each environment: envs.{name}.")
        found = getattr(self, name)
        result = found(*args, **kwargs) if callable(found) else found
        n = self.num_envs
        if name == "render":
            return result or n * (None,)
        if not callable(found) or name == "compute_reward":  # of any goals
            return n * (result,)
        if isinstance(result, np.ndarray) and result.shape[:1] == (n,):
            return tuple(result)
        if isinstance(result, tuple) and result and all(np.shape(x)[:1] == (n,) for x in result):
            return tuple(zip(*result, strict=True))
        return n * (result,)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Value of an attribute for each environment; they share it."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of all environments; a list or tuple must repeat one value for each."""
        if isinstance(values, list | tuple):
            if len(values) != self.num_envs:
                raise ValueError(
                    f"A list of values of {name!r} must have {self.num_envs} (one per "
                    f"environment), got {len(values)}: {validate.shown(values)}."
                )
            if not all(np.array_equal(value, values[0]) for value in values):
                raise ValueError(
                    f"{name!r} is shared by the batch and must be the same for all environments, "
                    f"got {validate.shown(values)}."
                )
            values = values[0]
        self.assign(name, values)

    # ---- the Gymnasium interface -------------------------------------------------------------

    def seed_streams(
        self, seed: int | Sequence[int | None] | None, rows: NDArray[np.int64] | None = None
    ) -> None:
        """Seed the random streams of `rows` (all) as single environments with these seeds do."""
        if seed is None:
            if not self._seeded:
                for i in range(self.num_envs):
                    self.core.seed(i, self.np_random)
        else:
            seeds = self._seeds(seed)
            for i in range(self.num_envs) if rows is None else rows.tolist():
                one = seeds[i]
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
        seeds = validate.sequence(seed, "seed, if it is not an int,")
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
        """Start episodes; environment i gets `seed + i` or `seed[i]`; options of `FlexArmEnv`.

        With `autoreset_mode` DISABLED, options["reset_mask"], (num_envs,) bool, selects the
        environments that restart; the others go on, and info is about those that restart.
        """
        self.core.claim()
        try:
            mask, placed = self._selected(options)
            rows = self._all if mask is None else np.flatnonzero(mask)
            self.seed_streams(seed, rows)
            out = self.core.reset(rows, placed)
            if mask is not None and self._latest is not None:
                out.obs[~mask] = self._latest[~mask]
            self._pending = np.setdiff1d(self._pending, rows)
            self._keep(out)
        finally:
            self.core.busy = False
        if self._renderer is not None and 0 in rows:
            self._renderer.follow(self.core)
        if self.render_mode == "human":
            self.render()
        info = out.marked() if mask is None else self._masked_info(out, mask)
        return self._observed(out.obs), info

    def _selected(self, options: Any) -> tuple[Flags | None, Any]:
        """The mask of environments to reset, None for all, and the other options."""
        if not isinstance(options, Mapping) or "reset_mask" not in options:
            return None, options
        mask = options["reset_mask"]
        if self.autoreset_mode is not AutoresetMode.DISABLED:
            raise ValueError(
                "options['reset_mask'] needs autoreset_mode='Disabled'; this batch restarts ended "
                f"episodes itself (autoreset_mode={self.autoreset_mode.value!r})."
            )
        shape, dtype = getattr(mask, "shape", None), getattr(mask, "dtype", None)
        if shape != (self.num_envs,) or dtype != np.bool_ or not mask.any():
            raise ValueError(
                f"options['reset_mask'] must be a bool array of shape ({self.num_envs},) with a "
                f"true value, got {validate.shown(mask)}."
            )
        if self._latest is None and not mask.all():
            raise gym.error.ResetNeeded("reset() all environments before some of them.")
        return mask, {key: value for key, value in options.items() if key != "reset_mask"}

    def _keep(self, out: BatchOutputs) -> None:
        """Keep the observations for a later reset of some environments."""
        if self.autoreset_mode is AutoresetMode.DISABLED:
            self._latest = out.obs.copy()

    def step(self, actions: Any) -> tuple[NDArray[np.float32], Array, Flags, Flags, dict[str, Any]]:
        """Advance all by one control step; ended episodes restart by `autoreset_mode`.

        Later steps do not overwrite a returned array while the caller keeps a reference to it.

        Raises
        ------
        ValueError : for actions of another shape than (N, n_torque) or that are not finite.
        ResetNeeded : before the first reset.
        RuntimeError : while another thread steps the batch.
        """
        array = self._actions(actions)
        self.claim_step()
        try:
            result = self._stepped(array)
        finally:
            self.core.busy = False
        if self._renderer is not None:
            self._renderer.follow(self.core)
        if self.render_mode == "human":
            self.render()
        return result

    def claim_step(self) -> None:
        """Mark the batch as busy for a step; a ResetNeeded before the first reset."""
        if not self.core.begun:
            raise reset_needed()
        self.core.claim()

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
        restarting = self.autoreset_mode is AutoresetMode.NEXT_STEP
        if self._pending.size and not restarting:
            raise gym.error.ResetNeeded(
                f"The episodes of the environments {validate.shown(self._pending.tolist())} have "
                "ended: reset(options={'reset_mask': terminated | truncated}) before the next step."
            )
        out, ended = self.core.step(actions)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            return self._restart_now(out, ended)
        self._keep(out)
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
        moved = out.described()["time"] > 0.0  # no reward at a reset
        return np.where(moved, reward, 0.0).astype(out.reward.dtype)

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
                "final_info": self._masked_info(out, done),
                "_final_info": done.copy(),
            }
            self.core.restart(rows, out)
        return self._observed(out.obs), *outcome, out.marked() | final

    def _masked_info(self, out: BatchOutputs, present: Flags) -> dict[str, Any]:
        """Copies of the info of this step, masked by `present`."""
        described = out.described()
        terms = described.pop("reward_terms")
        copies: dict[str, Any] = {name: values.copy() for name, values in described.items()}
        copies["reward_terms"] = {name: values.copy() for name, values in terms.items()}
        copies["reward_terms"] |= masks(terms, present)
        return copies | masks(copies, present)

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


def restarting_batch(
    env_id: str | EnvSpec, num_envs: int, keywords: Mapping[str, Any]
) -> FlexArmVectorEnv:
    """Batch of a registered id or a specification, whose ended episodes restart in the same step.

    Raises
    ------
    ValueError : the id has single environments alone.
    """
    spec = gym.registry.get(env_id.rpartition(":")[2]) if isinstance(env_id, str) else env_id
    if spec and spec.vector_entry_point is None:
        raise ValueError(
            f"{spec.id!r} is registered without a batch; register it with "
            "vector_entry_point='flexarm_env:FlexArmVectorEnv', or step its single environments, "
            "by DummyVecEnv of stable-baselines3 or SyncVectorEnv of Gymnasium."
        )
    envs = gym.make_vec(
        env_id, num_envs=num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **keywords
    )
    assert isinstance(envs, FlexArmVectorEnv)
    return envs
