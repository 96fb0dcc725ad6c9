"""One environment with the Gymnasium interface."""

import difflib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from dynamics.description.validate import choice, instance, shown
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.runtime.thread_pool import in_use
from dynamics.types import Array
from flexarm_env.arguments import not_finite, plain, whole_seed
from flexarm_env.core import Core
from flexarm_env.task.observations import GOALS, Layout
from flexarm_env.task.rewards import goal_reward

RENDER_MODES = ("human", "rgb_array")
SET_HERE = ("n_env", "single", "max_steps")  # keywords of `Core` that its environments set
KEYWORDS = frozenset(inspect.signature(Core).parameters) - {*SET_HERE}
OF_BATCHES = ("threads", "autoreset_mode", "num_envs", "n_envs")
CHANGEABLE = ("reward", "deflection_limit", "randomize", "max_episode_steps")
GUARDED = KEYWORDS | {*SET_HERE, *OF_BATCHES, "max_episode_steps", *FREE_PARAMETERS}
Observation = Any  # an array of float32, or with goals a dict of such arrays
_ONE = np.zeros(1, np.int64)


class Changeable:
    """Keywords that may change while an environment runs, as attributes; others are refused.

    Weights and limits hold from the next step, ranges of `randomize` from the next episode; a
    refused value changes nothing. Reading gives copies, so assign whole dicts. Other attributes,
    as those of a subclass, are free.
    """

    core: Core

    @property
    def reward(self) -> Any:
        """Weights in use by term, set by a preset's name or weights; None with obs="goal"."""
        return None if self.core.layout.goal else self.core.settings.weights.copy()

    @reward.setter
    def reward(self, given: Any) -> None:
        self.core.change(reward=given)

    @property
    def deflection_limit(self) -> float:
        """Deflection over length [-] above which an episode ends as invalid."""
        return self.core.settings.deflection_limit

    @deflection_limit.setter
    def deflection_limit(self, given: float) -> None:
        self.core.change(deflection_limit=given)

    @property
    def randomize(self) -> Any:
        """Ranges (low, high) of the free parameters; those left out become nominal again."""
        return self.core.settings.ranges.copy()

    @randomize.setter
    def randomize(self, given: Any) -> None:
        self.core.change(randomize=given)

    def assign(self, name: str, value: Any) -> None:
        """Set an attribute that is there; refuse other names with the nearest known one."""
        if name not in GUARDED and not hasattr(self, name):
            near = difflib.get_close_matches(name[:80], GUARDED, n=1)
            guess = f"did you mean {near[0]!r}? " if near else ""
            raise ValueError(
                f"Unknown attribute {shown(name)}; {guess}These may change: {self._changeable()}."
            )
        setattr(self, name, value)

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse keywords of construction once the environment is built."""
        if name in GUARDED and "core" in vars(self) and not _has_setter(type(self), name):
            raise ValueError(self._refusal(name, shown(value)))
        super().__setattr__(name, value)

    def _refusal(self, name: str, given: str) -> str:
        """Sentence for a keyword that cannot be set, with the remedy."""
        if name in FREE_PARAMETERS:
            how = "set" if name in self.core.randomize else "build a new environment with"
            return (
                f"{name} is a free parameter of the arm and no attribute, got {given}: {how} "
                f"randomize={{{name!r}: ({given}, {given})}}, beside the ranges of others."
            )
        if name == "max_episode_steps":
            return (
                "max_episode_steps of a single environment belongs to Gymnasium's TimeLimit, got "
                f"{given}: build a new environment with gymnasium.make(id, {name}={given})."
            )
        return (
            f"{name} cannot change in an environment that is built, got {given}: build a new one "
            f"with {name}={given}. These may change: {self._changeable()}."
        )

    def _changeable(self) -> list[str]:
        return [name for name in CHANGEABLE if _has_setter(type(self), name)]


class CoreAttributes(Changeable):
    """Attributes that the single and the batch environment read from their `core`."""

    _renderer: Any = None  # of the class, so that `close` finds it after a refused construction

    arm = property(lambda self: self.core.arm)
    model = property(lambda self: self.core.model)
    task = property(lambda self: self.core.task_name)
    control_dt = property(lambda self: self.core.control_dt)
    torque_limit = property(lambda self: self.core.torque_limit.copy())
    n_joint = property(lambda self: self.core.arm.n_joint)
    reach = property(lambda self: self.core.arm.reach)
    certificate = property(lambda self: self.core.certificate)
    uncertified = property(lambda self: self.core.uncertified)
    observation_slices = property(lambda self: self.core.layout.slices)
    observation_scales = property(lambda self: self.core.layout.scales)

    _spec: EnvSpec | None = None
    _np_random: np.random.Generator | None
    _np_random_seed: int | None
    _seeded: bool

    @property
    def spec(self) -> Any:
        """Gymnasium's specification, in which arrays, arms and the like are plain data."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        self._spec = given and replace(given, kwargs=plain(given.kwargs))

    @property
    def np_random(self) -> np.random.Generator:
        """Generator of the seeds of all random streams; one that is assigned seeds them at once."""
        generator: np.random.Generator = super().np_random  # type: ignore[misc]
        return generator

    @np_random.setter
    def np_random(self, generator: np.random.Generator) -> None:
        self._np_random = instance(generator, "np_random", np.random.Generator)
        self._np_random_seed = -1  # unknown, as Gymnasium has it
        for row in range(self.core.n_env):
            self.core.seed(row, generator)
        self._seeded = True

    @property
    def compute_reward(self) -> Callable[[Any, Any, Any], Any]:
        """Function (achieved, desired, info) of goals (k,) or (N, k); only with obs="goal"."""
        if not self.core.layout.goal:
            raise AttributeError("compute_reward is for obs='goal'")
        return goal_reward

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}


class FlexArmEnv(CoreAttributes, gym.Env[Observation, NDArray[np.float32]]):
    """One flexible arm with one task.

    A registered id sets `task`, `arm` and `control_dt`. The other keywords are those of
    `core.Core`, and `render_mode`: None, "rgb_array" or "human".
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 50}  # noqa: RUF012

    def __init__(self, *, render_mode: str | None = None, **arguments: Any) -> None:
        check_render_mode(render_mode)
        refuse_of_batches(arguments)
        check_keywords(arguments, "render_mode")
        self.render_mode = render_mode
        self.core = Core(single=True, **arguments)
        self.metadata = {**self.metadata, "render_fps": frames_per_second(self.core)}
        self.observation_space = observation_space(self.core.layout)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (self.core.arm.n_torque,), np.float32)
        self._several = self.core.arm.n_torque > 1
        self._observed, self._goal = self.core.layout.observed, bool(self.core.layout.goal)
        self._seeded = False

    # ---- for controllers -----------------------------------------------------------------------

    def joint_target(self) -> Array:
        """(n_joint,) [rad] joint angles that put the tip of the straight-link arm on the target."""
        return self.core.joint_target()[0]

    def joint_state(self) -> tuple[Array, Array]:
        """(n_joint,) [rad] and [rad/s] joint angles and rates, as ideal encoders read."""
        q, v = self.core.joint_state()
        return q[0], v[0]

    # ---- the Gymnasium interface -------------------------------------------------------------

    def set_wrapper_attr(self, name: str, value: Any, *, force: bool = True) -> bool:
        """Set an attribute; keywords are applied or refused here, and not stored in a wrapper."""
        return super().set_wrapper_attr(name, value, force=force or name in GUARDED)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; `options` may set "state" {"q", "v"} and "target" (joint angles)."""
        super().reset(seed=whole_seed(seed))
        self.core.claim()
        try:
            if seed is not None or not self._seeded:
                self.core.seed(0, self.np_random)
                self._seeded = True
            out = self.core.reset(_ONE, options)
            observation = self._observed(out.observation.copy())
            info = out.described(out.values.tolist(), out.marks.tolist())
        finally:
            self.core.busy = False
        self._follow()
        return observation, info

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by one control step under an action (n_torque,), clipped to [-1, 1].

        Raises
        ------
        ValueError : for an action of another shape or with numbers that are not finite.
        ResetNeeded : before the first reset.
        RuntimeError : while another thread steps the environment.
        """
        core = self.core
        if core.busy:  # `core.claim`, without the cost of a call
            raise in_use()
        if not core.begun:
            raise reset_needed()
        core.busy = True
        try:
            advance, out = core.alone
            self._store(core.action, action)
            if advance() < 0:
                raise not_finite(core.action)
            values, marks = out.values.tolist(), out.marks.tolist()
            info, flat = out.described(values, marks), out.observation.copy()
        finally:
            core.busy = False
        if self.render_mode is not None:
            self._follow()
        if self._goal:
            observation = self._observed(flat)
            achieved, desired = (observation[name] for name in GOALS)
            reward = self.compute_reward(achieved, desired, info)
            return observation, reward, marks[0], marks[1], info
        return flat, values[0], marks[0], marks[1], info

    def _follow(self) -> None:
        if self._renderer is not None:
            self._renderer.follow(self.core)
        if self.render_mode == "human":
            self.render()

    def _store(self, place: NDArray[np.float32], action: Any) -> None:
        try:
            if self._several and len(action) != place.size:  # NumPy broadcasts one
                raise ValueError
            place[...] = action
        except (TypeError, ValueError):
            raise ValueError(
                f"An action must have shape ({place.size},), in [-1, 1], got {shown(action)}."
            ) from None

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the arm: return an (H, W, 3) picture, or show it in a window and return None."""
        if self.render_mode is None:
            gym.logger.warn('render() needs render_mode="rgb_array" or "human" at construction.')
            return None
        if self._renderer is None:
            from flexarm_env.rendering import Renderer

            self._renderer = Renderer(self.core)
        picture = self._renderer.draw(self.core)
        if self.render_mode == "human":
            self._renderer.show(picture, self.core.control_dt)
            return None
        return picture

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def reset_needed() -> gym.error.ResetNeeded:
    """Error for a step before the first reset."""
    return gym.error.ResetNeeded("Call reset() before step().")


class KeywordError(TypeError, ValueError):
    """An unknown keyword, of Python's type and in its words.

    Libraries try keywords of their own, as TorchRL's `GymEnv` does, and look for them.
    """


def check_render_mode(mode: str | None) -> None:
    """Raise a ValueError for an unknown render mode."""
    if mode is not None:
        choice(mode, "render_mode", RENDER_MODES)


def check_keywords(arguments: Mapping[str, Any], *others: str) -> None:
    """Raise a KeywordError for a keyword that neither `Core` has nor is one of `others`.

    Also without a task or an arm, which registered ids set.
    """
    known = KEYWORDS | {*others}
    for name in arguments:
        if name not in known:
            (near,) = difflib.get_close_matches(name[:80], sorted(known), n=1, cutoff=0.0)
            raise KeywordError(
                f"An environment got an unexpected keyword argument {shown(name)}; nearest known: "
                f"{near!r}."
            )
    for name, such in (("task", 'task="Reach"'), ("arm", 'arm="slim"')):
        if name not in arguments:
            raise ValueError(
                f"{name} is missing; make a registered id, or give one, such as {such}, also in "
                "the kwargs of gymnasium.register."
            )


def refuse_of_batches(arguments: Mapping[str, Any]) -> None:
    """Raise a ValueError with the remedy for a keyword of a batch."""
    for name in set(arguments) & {*OF_BATCHES}:
        given = shown(arguments[name])
        count = name in ("num_envs", "n_envs")
        batch = f"num_envs={given}" if count else f"num_envs=N, {name}={given}"
        raise ValueError(
            f"{name} is for a batch; leave it out, or use gymnasium.make_vec(id, {batch})."
        )
    for name in set(arguments) & {*SET_HERE}:
        raise ValueError(f"{name} is for a batch; this is a single environment.")
    if "max_episode_steps" in arguments:
        raise ValueError(
            "max_episode_steps is for gymnasium.make and for a batch; leave it out, or use "
            f"gymnasium.make(id, max_episode_steps={shown(arguments['max_episode_steps'])})."
        )


def _has_setter(kind: type, name: str) -> bool:
    return getattr(getattr(kind, name, None), "fset", None) is not None


def frames_per_second(core: Core) -> int:
    """Frame rate of a real-time film with one picture per control step."""
    return max(1, round(1.0 / core.control_dt))


def observation_space(layout: Layout) -> Any:
    """Gymnasium space of an observation layout."""
    bound = layout.observed(layout.bounds.astype(np.float32))
    if not layout.goal:
        return gym.spaces.Box(-bound, bound, dtype=np.float32)
    boxes: dict[str, gym.Space[Any]] = {
        name: gym.spaces.Box(-x, x, dtype=np.float32) for name, x in bound.items()
    }
    return gym.spaces.Dict(boxes)
