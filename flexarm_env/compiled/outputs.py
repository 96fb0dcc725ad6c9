"""What environments say after a step: one set of arrays, and views of them by name."""

from collections.abc import Callable, Iterable, Mapping
from sys import getrefcount
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.types import AnyArray
from flexarm_env.compiled.rows import Rows
from flexarm_env.compiled.signals import FLAGS, NUMBERS
from flexarm_env.rewards import TERMS

WIDE = ("root_curvature", "torque", "command")  # of info, as far as there: several rows each
SETTLED = 2  # first row of flags that info tells
SPARE = 3  # sets kept: with the caller, being filled, and one that the caller copied late


class Outputs:
    """Arrays that a step fills; a new step may fill them again once nobody else holds any.

    Attributes
    ----------
    obs : (N, size) observations.
    info : (rows, width) numbers, a row per name, a column per environment.
    flags : (len(FLAGS), width) marks likewise.
    unused : whether nobody else holds any of the arrays.
    """

    unused: Any = True

    def __init__(self, n_env: int, size: int, width: int, dtype: Any, names: Rows) -> None:
        self.obs = np.empty((n_env, size), np.float32)
        self.info = np.empty((names.total, width), dtype)
        self.flags = np.empty((len(FLAGS), width), np.bool_)


class SingleOutputs(Outputs):
    """What a single environment says, for it to copy.

    Attributes
    ----------
    observation : (size,)
    values, marks : the columns of info, but for what is wide, and of flags.
    described : function of both, as lists, that makes a dict of info.
    """

    def __init__(self, n_env: int, size: int, width: int, dtype: Any, names: Rows) -> None:
        super().__init__(n_env, size, width, dtype, names)
        self.observation, column, self.marks = self.obs[0], self.info[:, 0], self.flags[:, 0]
        self.values = column[: names.slices["reward_terms"].stop]
        wide = {name: column[names.slices[name]] for name in WIDE if name in names.slices}
        self.described = _describer(names, wide)


class BatchOutputs(Outputs):
    """What a batch says: views of the arrays, where a part of one holds the whole.

    Attributes
    ----------
    reward, terminated, truncated : (N,) rows of info and flags.
    """

    def __init__(self, n_env: int, size: int, width: int, dtype: Any, names: Rows) -> None:
        super().__init__(n_env, size, width, dtype, names)
        self._arrays = [self.obs, self.info, self.flags, *self._views(n_env, names)]
        self._alone = sum(map(getrefcount, self._arrays))

    @property
    def unused(self) -> bool:
        return sum(map(getrefcount, self._arrays)) == self._alone

    def _views(self, n_env: int, names: Rows) -> list[AnyArray]:
        values, marks = list(self.info[:, :n_env]), list(self.flags[:, :n_env])
        self.reward, self.terminated, self.truncated = values[0], marks[0], marks[1]
        named = {name: names.slices[name] for name in WIDE if name in names.slices}
        terms = names.slices["reward_terms"]
        self._terms = dict(zip(TERMS, values[terms], strict=True))
        self._named: dict[str, Any] = dict(zip(NUMBERS, values[1 : terms.start], strict=True))
        self._named |= {name: self.info[at, :n_env].T for name, at in named.items()}
        self._named |= dict(zip(FLAGS[SETTLED:], marks[SETTLED:], strict=True))
        everyone = np.ones(n_env, np.bool_)
        everyone.flags.writeable = False  # shared by all steps' infos
        self._marked = self._named | masks((*self._named, "reward_terms"), everyone)
        self._marked_terms = self._terms | masks(TERMS, everyone)
        outcome = [self.reward, self.terminated, self.truncated]
        return [*outcome, *self._terms.values(), *self._named.values()]

    def described(self) -> dict[str, Any]:
        """Info by name, reward terms in a dict of their own: new dicts of the same arrays."""
        return {**self._named, "reward_terms": self._terms.copy()}

    def marked(self) -> dict[str, Any]:
        """The same with Gymnasium's masks, which say that every environment has it."""
        marked = self._marked.copy()
        marked["reward_terms"] = self._marked_terms.copy()
        return marked


def _describer(names: Rows, wide: Mapping[str, AnyArray]) -> Callable[..., dict[str, Any]]:
    """A function of values and marks that makes a dict of info, with copies of what is wide.

    It is written out, entry by entry: a single environment's step feels how a dict is made.
    """

    def entries(names: Iterable[str], listed: str, first: int) -> str:
        return ", ".join(f"{name!r}: {listed}[{k}]" for k, name in enumerate(names, first))

    text = ", ".join([
        entries(NUMBERS, "values", names.slices[NUMBERS[0]].start),
        *(f"{name!r}: {name}.copy()" for name in wide),
        entries(FLAGS[SETTLED:], "marks", SETTLED),
        f"'reward_terms': {{{entries(TERMS, 'values', names.slices['reward_terms'].start)}}}",
    ])  # fmt: skip
    return eval(f"lambda values, marks: {{{text}}}", dict(wide))


def masks(names: Iterable[str], whose: NDArray[np.bool_]) -> dict[str, NDArray[np.bool_]]:
    """Gymnasium's masks: which environments have the infos of these names."""
    return {f"_{name}": whose for name in names}
