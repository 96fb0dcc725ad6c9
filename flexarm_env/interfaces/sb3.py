"""Batch environment for stable-baselines3, which has a vector interface of its own."""

import operator
import time
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from dynamics.description import validate
from dynamics.extras import missing
from flexarm_env.arguments import whole_seed
from flexarm_env.compiled.outputs import BatchOutputs
from flexarm_env.interfaces.env import Changeable
from flexarm_env.interfaces.vector import restarting_batch

try:
    from stable_baselines3.common.vec_env import VecEnv

    from flexarm_env.interfaces.tensors.privileged import Privileged
except ModuleNotFoundError as error:
    raise missing(error, "SB3VecEnv", "train") from None


REFUSED = {"autoreset_mode": "SAME_STEP", "vectorization_mode": "one compiled batch"}
AT_ENDS = frozenset({"episode", "is_success", "terminal_observation", "TimeLimit.truncated"})


class StepInfo(dict[str, Any]):
    """Info of one environment after a step."""

    __slots__ = ("row", "source")
    row: int  # of the environment
    source: Callable[[int], dict[str, Any]]  # entries from the row

    def filled(self) -> "StepInfo":
        """Itself, with its entries."""
        return self

    def __reduce__(self) -> Any:
        """Copies and pickles are plain dicts."""
        return dict, (dict(self),)


class RunningInfo(StepInfo):
    """Info of an environment whose episode goes on, filled when it is first used.

    Few infos of a batch are ever looked at, and filling all takes longer than the step. `source`
    is that of `BatchOutputs.by_row`.
    """

    __slots__ = ()

    def filled(self) -> StepInfo:
        """Itself, with its entries and from then on an ordinary dict."""
        self.__class__ = StepInfo  # type: ignore[assignment]
        if hasattr(self, "source"):
            self.update(self.source(self.row))
            del self.source
        return self

    def get(self, key: str, default: Any = None) -> Any:
        """Entry of a key; learners ask for those of an end at every step."""
        if key in AT_ENDS and self.__class__ is RunningInfo:
            return default
        return dict.get(self.filled(), key, default)

    def __contains__(self, key: object) -> bool:
        return dict.__contains__(self if key in AT_ENDS else self.filled(), key)


def _method(name: str) -> Any:
    return lambda self, *args, **kwargs: getattr(self.filled(), name)(*args, **kwargs)


def _operator(operation: Any) -> Any:  # Python then fills the other side, too
    return lambda self, other: operation(self.filled(), other)


for _name in (
    "__getitem__", "__setitem__", "__delitem__", "__iter__", "__reversed__", "__len__", "__repr__",
    "copy", "keys", "values", "items", "pop", "popitem", "setdefault", "update", "clear",
):  # fmt: skip
    setattr(RunningInfo, _name, _method(_name))
for _operation in (operator.eq, operator.ne, operator.or_, operator.ior):
    setattr(RunningInfo, f"__{_operation.__name__.strip('_')}__", _operator(_operation))


class SB3VecEnv(Changeable, VecEnv):
    """N environments of a registered id, stepped together.

    Infos have the environment's own entries. An environment whose episode ended restarts in the
    same step. Its info has those of a `DummyVecEnv` of monitored environments besides:
    "terminal_observation", "TimeLimit.truncated", "episode" (return, length, time) and "is_success"
    (tip on the target at the end of an episode that did not fail).

    With `privileged=True` observations are dicts: "observation" is for the actor, and "privileged"
    for its critic alone, the true state, drawn parameters and delay of `TorchVecEnv.privileged`.
    """

    _privileged: Privileged | None

    def __init__(
        self,
        id: str,
        n_envs: int | None = None,
        *,
        num_envs: int | None = None,
        privileged: bool = False,
        **kwargs: Any,
    ) -> None:
        """Take the number of environments as `n_envs` or, as `gymnasium.make_vec`, `num_envs`."""
        given = [n for n in (n_envs, num_envs) if n is not None]
        if len(given) != 1:
            raise ValueError(
                f"Give the number of environments once, as n_envs or num_envs, got n_envs={n_envs} "
                f"and num_envs={num_envs}."
            )
        for name in REFUSED.keys() & kwargs.keys():
            raise ValueError(
                f"{name} of SB3VecEnv is always {REFUSED[name]}, got "
                f"{validate.shown(kwargs[name])}; leave it out."
            )
        n_envs = given[0]
        envs = restarting_batch(id, n_envs, kwargs)
        self.envs, self._privileged = envs, None
        space = envs.single_observation_space
        if validate.boolean(privileged, "privileged"):
            if envs.core.layout.goal:
                raise ValueError(
                    "privileged=True takes observations of one vector, got obs='goal', whose dicts "
                    "have no part for a critic; leave privileged out, or take another obs."
                )
            self._privileged = Privileged(envs.core)
            size = sum(self._privileged.sizes.values())
            space = gym.spaces.Dict(
                observation=space, privileged=gym.spaces.Box(-np.inf, np.inf, (size,))
            )
        super().__init__(n_envs, space, envs.single_action_space)
        self.metadata = envs.metadata  # the frame rate of films
        self._actions: NDArray[np.float32] = np.zeros(envs.action_space.shape or (), np.float32)
        self._returns, self._lengths = np.zeros(n_envs), np.zeros(n_envs, np.int64)
        self._started = time.time()
        self.core = envs.core  # from here on keywords are guarded

    @property
    def max_episode_steps(self) -> int:
        """Control steps after which an episode is truncated; -1: never."""
        return self.envs.max_episode_steps

    @max_episode_steps.setter
    def max_episode_steps(self, given: int | None) -> None:
        self.envs.max_episode_steps = given

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed environment i with `seed` + i at the next reset; a ValueError for no seed."""
        return super().seed(whole_seed(seed))

    def reset(self) -> Any:
        """Start episodes, with the seeds and options set by `seed` and `set_options`."""
        seeds = [None if seed is None else int(seed) for seed in self._seeds]
        given = any(seed is not None for seed in seeds)
        self.core.claim()
        try:
            before = self.core.state.copy(), self.core.streams.copy(), self.core.begun
            self.envs.seed_streams(seeds if given else None)
            out = self.core.reset(np.flatnonzero([not options for options in self._options]))
            for i, options in enumerate(self._options):
                if options:
                    self.core.restart(np.array([i]), out, options)
        except ValueError:
            self.core.state[...], self.core.streams[...], self.core.begun = before
            raise
        finally:
            self.core.busy = False
        self._returns[:], self._lengths[:] = 0.0, 0
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = self._infos(out.by_row())
        return self._observed(self._elements(out))

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Store the actions for `step_wait`."""
        self._actions = self.envs._actions(actions)

    def step_wait(self) -> Any:
        """Advance all by one control step."""
        self.envs.claim_step()
        try:
            return self._stepped()
        finally:
            self.core.busy = False

    def _stepped(self) -> Any:
        out, ended = self.core.step(self._actions)
        rewarded = self.envs.rewarded(out)
        self._returns += rewarded
        reward = rewarded.astype(np.float32)  # a copy: a restart writes over the outputs
        self._lengths += 1
        by_row = out.by_row()
        infos = self._infos(by_row)
        dones = out.terminated | out.truncated
        if ended:
            rows, last = np.flatnonzero(dones), self._elements(out)
            for i in rows.tolist():
                infos[i] = self._ended_info(i, out, by_row(i))
                infos[i]["terminal_observation"] = self._observed(last[i].copy())
            self.core.restart(rows, out)
            self._returns[rows], self._lengths[rows] = 0.0, 0
            for i in rows.tolist():
                self.reset_infos[i] = by_row(i)
        return self._observed(self._elements(out)), reward, dones, infos

    def _elements(self, out: BatchOutputs) -> Any:
        """(N, size) numbers of the observations, and behind them those of a critic."""
        if self._privileged is None:
            return out.obs
        return np.hstack([out.obs, self._privileged.on_host()])

    def _observed(self, elements: Any) -> Any:
        """Observation of elements (..., size): an array, or a dict of views."""
        if self._privileged is None:
            return self.core.layout.observed(elements)
        size = self.core.layout.size
        return {"observation": elements[..., :size], "privileged": elements[..., size:]}

    def _infos(self, source: Callable[[int], dict[str, Any]]) -> list[dict[str, Any]]:
        infos: list[dict[str, Any]] = []
        for row in range(self.num_envs):
            info = RunningInfo()  # its own constructor would take twice as long
            info.source, info.row = source, row
            infos.append(info)
        return infos

    def _ended_info(self, i: int, out: BatchOutputs, info: dict[str, Any]) -> dict[str, Any]:
        """Add what is known of environment i, whose episode ended, to its info."""
        info["TimeLimit.truncated"] = bool(out.truncated[i] and not out.terminated[i])
        info["is_success"] = bool(info["settled"] and not out.terminated[i])
        info["episode"] = {
            "r": round(float(self._returns[i]), 6),
            "l": int(self._lengths[i]),
            "t": round(time.time() - self._started, 6),
        }
        return info

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Value of an attribute, which all environments share, once per environment."""
        value = getattr(self.envs, attr_name)
        return [value for _ in self._rows(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of all environments, which share it; see `Changeable`."""
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise ValueError(f"{attr_name!r} is shared by the batch: set it for all environments.")
        self.envs.assign(attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the batch; a result with one row per environment is split."""
        rows = self._rows(indices)
        if method_name == "get_wrapper_attr":
            return self.get_attr(method_args[0], indices)
        if method_name == "set_wrapper_attr":
            self.set_attr(method_args[0], method_args[1], indices)
            return [True for _ in rows]
        results = self.envs.call(method_name, *method_args, **method_kwargs)
        return [results[i] for i in rows]

    def _rows(self, indices: Any) -> list[int]:
        """Environments that indices name; refuses those that there are not."""
        rows = list(self._get_indices(indices))
        for row in rows:
            if not -self.num_envs <= row < self.num_envs:
                raise ValueError(f"indices must be below {self.num_envs}, got {row}.")
        return rows

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: Any = None) -> list[bool]:
        """True for `Monitor`, whose job this class does; no other wrapper is present."""
        return [wrapper_class.__name__ == "Monitor" for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[Any]:
        """Return one picture per environment."""
        return self.envs.render() or [None] * self.num_envs

    def close(self) -> None:
        """Close the window, if there is one."""
        self.envs.close()
