"""What environments say after a step: one set of arrays, and views of them by name."""

from abc import ABC, abstractmethod
from sys import getrefcount
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexarm_env.report import FLAGS, NUMBERS, Rows
from flexarm_env.rewards import TERMS

Array = NDArray[Any]
BLOCKS = ("reward_terms", "root_curvature", "torque", "command")  # rows of info behind NUMBERS
SETTLED = 2  # first row of flags that info tells
SPARE = 3  # sets kept: with the caller, being filled, and one that the caller copied late


class Outputs(ABC):
    """Arrays that a step fills; a new step may fill them again once nobody else holds any.

    Attributes
    ----------
    obs : (N, size) observations.
    info : (rows, width) numbers, a row per name, a column per environment.
    flags : (len(FLAGS), width) marks likewise.
    """

    def __init__(self, n_env: int, size: int, width: int, dtype: Any, names: Rows) -> None:
        self.obs = np.empty((n_env, size), np.float32)
        self.info = np.empty((names.total, width), dtype)
        self.flags = np.empty((len(FLAGS), width), np.bool_)
        self._arrays = [self.obs, self.info, self.flags, *self._views(n_env, names)]
        self._alone = list(map(getrefcount, self._arrays))

    @abstractmethod
    def _views(self, n_env: int, names: Rows) -> list[Array]:
        """Views of the arrays that others are given."""

    @property
    def unused(self) -> bool:
        """Whether nobody else holds any of the arrays: a part of one holds the whole."""
        return list(map(getrefcount, self._arrays)) == self._alone


class SingleOutputs(Outputs):
    """What a single environment says.

    Attributes
    ----------
    observation : (size,)
    blocks : wide entries of info by name, but for reward terms.
    """

    def _views(self, n_env: int, names: Rows) -> list[Array]:
        self.observation = self.obs[0]
        wide = [name for name in BLOCKS[1:] if name in names.slices]
        self.blocks: dict[str, Array] = {name: self.info[names.slices[name], 0] for name in wide}
        return [self.observation, *self.blocks.values()]


class BatchOutputs(Outputs):
    """What a batch says.

    Attributes
    ----------
    reward, terminated, truncated : (N,) rows of info and flags.
    """

    def _views(self, n_env: int, names: Rows) -> list[Array]:
        values, marks = list(self.info[:, :n_env]), list(self.flags[:, :n_env])
        self.reward, self.terminated, self.truncated = values[0], marks[0], marks[1]
        named = {name: names.slices[name] for name in BLOCKS if name in names.slices}
        terms = named.pop("reward_terms")
        self._terms = dict(zip(TERMS, values[terms], strict=True))
        self._named: dict[str, Any] = dict(zip(NUMBERS, values[1 : terms.start], strict=True))
        self._named |= {name: self.info[at, :n_env].T for name, at in named.items()}
        self._named |= dict(zip(FLAGS[SETTLED:], marks[SETTLED:], strict=True))
        outcome = [self.reward, self.terminated, self.truncated]
        return [*outcome, *self._terms.values(), *self._named.values()]

    def described(self) -> dict[str, Any]:
        """Info by name, reward terms in a dict of their own: new dicts of the same arrays."""
        return {**self._named, "reward_terms": dict(self._terms)}
