"""Outputs of a step: arrays that the compiled step fills, and views of them by name."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from sys import getrefcount
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.runtime.jit import aligned_zeros
from dynamics.types import AnyArray
from flexarm_env.compiled.rows import Rows
from flexarm_env.compiled.termination import FLAGS
from flexarm_env.task.rewards import TERMS

# vector-valued info entries, where present
WIDE = ("root_curvature", "torque", "command", "linear_momentum")
SETTLED = 2  # first row of the flags that info holds
SPARE = 3  # sets of arrays in rotation: the caller's, the one being filled, and a spare one


class Outputs:
    """Arrays that a step fills; reused by later steps once no caller refers to any of them.

    Attributes
    ----------
    obs : (N, size) observations.
    info : (rows, width) numbers, a row per name, a column per environment.
    flags : (len(FLAGS), width) booleans, a row per name, a column per environment.
    unused : whether no caller refers to any of the arrays.
    """

    unused: Any = True

    def __init__(self, n_env: int, size: int, width: int, dtype: Any, names: Rows) -> None:
        self.obs = aligned_zeros((n_env, size), np.float32)
        self.info = aligned_zeros((names.total, width), dtype)
        self.flags = aligned_zeros((len(FLAGS), width), np.bool_)


class SingleOutputs(Outputs):
    """Outputs of a single environment; the environment copies them.

    Attributes
    ----------
    observation : (size,)
    values, marks : the columns of info, without the vector-valued entries, and of flags.
    described : function from `values` and `marks`, as lists, to the info dict.
    """

    def __init__(self, n_env: int, size: int, width: int, dtype: Any, names: Rows) -> None:
        super().__init__(n_env, size, width, dtype, names)
        self.observation, column, self.marks = self.obs[0], self.info[:, 0], self.flags[:, 0]
        self.values = column[: names.slices["reward_terms"].stop]
        wide = {name: column[at].copy for name, at in _wide(names).items()}
        self.described = _describer(names, {name: f"{name}()" for name in wide}, wide)


class BatchOutputs(Outputs):
    """Outputs of a batch: views of the arrays, which a caller may keep.

    Attributes
    ----------
    reward, terminated, truncated : (N,) rows of info and flags.
    """

    def __init__(self, n_env: int, size: int, width: int, dtype: Any, names: Rows) -> None:
        super().__init__(n_env, size, width, dtype, names)
        self._arrays: list[Any] = [self.obs, self.info, self.flags, *self._views(n_env, names)]
        # views that a caller makes of these refer to the memory below them
        self._arrays += [array.base for array in self._arrays[:3]]
        self._own_references = sum(map(getrefcount, self._arrays))

    @property
    def unused(self) -> bool:
        return sum(map(getrefcount, self._arrays)) == self._own_references

    def _views(self, n_env: int, names: Rows) -> list[AnyArray]:
        values, marks = list(self.info[:, :n_env]), list(self.flags[:, :n_env])
        self.reward, self.terminated, self.truncated = values[0], marks[0], marks[1]
        named = _wide(names)
        wide = {name: f"column[{at.start}:{at.stop}].copy()" for name, at in named.items()}
        self._of_column = _describer(names, wide, {}, "values, marks, column")
        terms = names.slices["reward_terms"]
        self._terms = dict(zip(TERMS, values[terms], strict=True))
        numbers = zip(scalars(names), values[1 : terms.start], strict=True)
        self._named: dict[str, Any] = dict(numbers)
        self._named |= {name: self.info[at, :n_env].T for name, at in named.items()}
        self._named |= dict(zip(FLAGS[SETTLED:], marks[SETTLED:], strict=True))
        present = np.ones(n_env, np.bool_)
        present.flags.writeable = False  # the infos of all steps share it
        self._marked = self._named | masks((*self._named, "reward_terms"), present)
        self._marked_terms = self._terms | masks(TERMS, present)
        outcome = [self.reward, self.terminated, self.truncated]
        return [*outcome, *self._terms.values(), *self._named.values()]

    def described(self) -> dict[str, Any]:
        """Info by name, with a nested dict of reward terms: new dicts of the same arrays."""
        return {**self._named, "reward_terms": self._terms.copy()}

    def marked(self) -> dict[str, Any]:
        """Info as `described`, with Gymnasium's masks; every environment has every entry."""
        marked = self._marked.copy()
        marked["reward_terms"] = self._marked_terms.copy()
        return marked

    def by_row(self) -> Callable[[int], dict[str, Any]]:
        """Function from an environment to its info, as a single environment gives it.

        No later step overwrites the arrays while a caller keeps the function.
        """
        return partial(_of_row, self.info, self.flags, self._of_column)


def _of_row(info: AnyArray, flags: AnyArray, described: Callable[..., Any], row: int) -> Any:
    column = info[:, row]
    return described(column.tolist(), flags[:, row].tolist(), column)


def _wide(names: Rows) -> dict[str, slice]:
    return {name: names.slices[name] for name in WIDE if name in names.slices}


def _describer(
    names: Rows, wide: Mapping[str, str], given: dict[str, Any], arguments: str = "values, marks"
) -> Callable[..., Any]:
    """Function from values and marks to the info dict; `wide` has the text of the other entries.

    The dict is generated as one literal, because building it takes a notable part of a single
    environment's step.
    """

    def entries(names: Iterable[str], listed: str, first: int) -> str:
        return ", ".join(f"{name!r}: {listed}[{k}]" for k, name in enumerate(names, first))

    text = ", ".join([
        entries(scalars(names), "values", 1),
        *(f"{name!r}: {text}" for name, text in wide.items()),
        entries(FLAGS[SETTLED:], "marks", SETTLED),
        f"'reward_terms': {{{entries(TERMS, 'values', names.slices['reward_terms'].start)}}}",
    ])  # fmt: skip
    return eval(f"lambda {arguments}: {{{text}}}", given)


def scalars(names: Rows) -> list[str]:
    """Info entries of one number each: those between the reward and its terms."""
    listed = list(names.sizes)
    return listed[1 : listed.index("reward_terms")]


def masks(names: Iterable[str], present: NDArray[np.bool_]) -> dict[str, NDArray[np.bool_]]:
    """Gymnasium's masks: the environments that have the infos of these names."""
    return {f"_{name}": present for name in names}
