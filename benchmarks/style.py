"""Colours and markers of the charts, for colour-blind readers too.

Colours are those of Okabe and Ito, and four of Paul Tol's. What a chart compares differs in marker
as well as in colour.
"""

from collections.abc import Sequence
from typing import Any, TypeVar

from dynamics.integrators.table import INTEGRATORS

T = TypeVar("T")

BLACK, GREY = "#000000", "#999999"
BLUE, SKY, GREEN = "#0072B2", "#56B4E9", "#009E73"
VERMILLION, ORANGE, PURPLE = "#D55E00", "#E69F00", "#CC79A7"
WINE, INDIGO, SAND, FOREST = "#661100", "#332288", "#DDCC77", "#117733"
CYCLE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK, WINE, INDIGO, SAND, FOREST)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "h", "d", "8")
MARKED = 8  # markers of a line of many points
STABLE, FAILED = "#DCEBF5", ORANGE  # cells of a map; they differ in lightness too
ENGINES = {  # beginning of an engine's name: its line in every chart
    "ours, one environment": {"color": BLUE, "marker": "o"},
    "ours": {"color": BLUE, "marker": "D", "markerfacecolor": "white", "linestyle": "--"},
    "Exudyn, cable": {"color": VERMILLION, "marker": "s"},
    "Exudyn": {"color": ORANGE, "marker": "^"},
    "MuJoCo": {"color": BLACK, "marker": "v"},
}


def pyplot() -> Any:
    """The module matplotlib.pyplot, without a window and with the colours of CYCLE."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib import rcsetup

    plt.rcParams["axes.prop_cycle"] = rcsetup.cycler(color=CYCLE)
    return plt


def series(k: int) -> dict[str, Any]:
    """Colour and marker of the k-th of several alike lines."""
    return {"color": CYCLE[k % len(CYCLE)], "marker": MARKERS[k % len(MARKERS)]}


def marked(k: int, count: int) -> dict[str, Any]:
    """Colour of the k-th line of `count` points, and about MARKED markers at places of its own."""
    every = max(1, count // MARKED)
    return series(k) | {"markevery": (k * every // 6, every)}


def method(name: str) -> dict[str, Any]:
    """Colour and marker of an integrator; methods of SciPy are grey."""
    if name in INTEGRATORS:
        return series(list(INTEGRATORS).index(name))
    return {"color": GREY, "marker": "*" if name == "bdf" else "p"}


def engine(name: str) -> dict[str, Any]:
    """Colour, marker and dashes of an engine in comparisons with peers."""
    known = [key for key in ENGINES if name.startswith(key)]
    found = ENGINES[max(known, key=len)] if known else {"color": GREY, "marker": "X"}
    return {"linestyle": "-", **found}


def thinned(points: Sequence[T], errors: Sequence[float], ratio: float) -> list[T]:
    """Points, ever more accurate ones, whose errors fall by `ratio` or more; and the last."""
    result: list[T] = []
    before = float("inf")
    for point, error in zip(points, errors, strict=True):
        if error <= before / ratio:
            result.append(point)
            before = error
    return [*result, *([points[-1]] if points and points[-1] not in result else [])]
