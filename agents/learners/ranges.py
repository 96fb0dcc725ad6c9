"""Ranges of agent keywords, the section `sweep` of an experiment, and values drawn from them."""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from dynamics.description import validate

DIGITS = 4  # significant ones of drawn numbers
DEFAULTS: dict[str, dict[str, Any]] = {  # for the keywords that the algorithm has
    "learning_rate": {"between": [1e-4, 1e-2], "log": True},
    "gamma": {"between": [0.9, 0.995]},
    "gae_lambda": {"between": [0.8, 1.0]},
    "tau": {"between": [2e-3, 5e-2], "log": True},
}
Draw = Callable[[str, Mapping[str, Any]], Any]  # of a keyword and its range, a value
FORMS = "{between: [LOW, HIGH]}, {between: [LOW, HIGH], log: true} or {among: [VALUE, ...]}"


def checked_ranges(ranges: Any) -> Iterator[tuple[str, Any]]:
    """Yield every keyword with each value that bounds or makes its range; refuses other forms."""
    for key, table in ranges.items():
        if not isinstance(table, Mapping) or not well_formed(table):
            raise ValueError(f"sweep.{key} must be {FORMS}, got {validate.shown(table)}.")
        for value in table.get("among", table.get("between")):
            yield str(key), value


def well_formed(table: Mapping[str, Any]) -> bool:
    """True for a range of one of the FORMS."""
    if set(table) == {"among"}:
        return isinstance(table["among"], list) and bool(table["among"])
    ends = table.get("between")
    if not set(table) <= {"between", "log"} or not isinstance(ends, list) or len(ends) != 2:
        return False
    numbers = all(isinstance(x, int | float) and not isinstance(x, bool) for x in ends)
    log = table.get("log", False)
    return numbers and isinstance(log, bool) and ends[0] < ends[1] and (not log or ends[0] > 0)


def drawn(ranges: Mapping[str, Any], kwargs: Mapping[str, Any], draw: Draw) -> dict[str, Any]:
    """A value per range; a number in place of a falling one ("lin_3.0e-4") falls too."""
    values: dict[str, Any] = {}
    for key, table in ranges.items():
        value = draw(key, table)
        if "between" in table and isinstance(value, float):
            value = float(f"{value:.{DIGITS}g}")
        falling = "between" in table and str(kwargs.get(key, "")).startswith("lin_")
        values[key] = f"lin_{value}" if falling else value
    return values


def at_random(rng: np.random.Generator) -> Draw:
    """Values that do not depend on earlier ones."""

    def draw(key: str, table: Mapping[str, Any]) -> Any:
        if "among" in table:
            return table["among"][rng.integers(len(table["among"]))]
        (low, high), whole, log = span(table)
        high += whole
        if log:
            number = math.exp(rng.uniform(math.log(low), math.log(high)))
        else:
            number = rng.uniform(low, high)
        return int(number) if whole else number

    return draw


def suggested(trial: Any) -> Draw:
    """Values that a trial of Optuna suggests."""

    def draw(key: str, table: Mapping[str, Any]) -> Any:
        if "among" in table:
            return table["among"][trial.suggest_int(key, 0, len(table["among"]) - 1)]
        (low, high), whole, log = span(table)
        suggest = trial.suggest_int if whole else trial.suggest_float
        return suggest(key, low, high, log=log)

    return draw


def span(table: Mapping[str, Any]) -> tuple[tuple[Any, Any], bool, bool]:
    """Ends of a range of numbers; whether it holds whole ones alone; whether it is logarithmic."""
    low, high = table["between"]
    whole = isinstance(low, int) and isinstance(high, int)
    return (low, high), whole, bool(table.get("log", False))
