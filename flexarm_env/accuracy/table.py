"""Tables of a certificate and of measured steps, as on the page of an environment."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

CERTIFICATE = (
    ("error", "model and step together, from the reference"),
    ("integration", "the step alone, from the same model with fine steps"),
    ("truncation", "the model from a rich one, of six bending and two torsion modes per link"),
    ("nonlinear", "the rich model from the reference, whose links are cut into segments"),
    ("residual", "the reference from a finer one with half its step"),
)


def table(header: Sequence[str], rows: Iterable[Sequence[str]], align: str = "l") -> str:
    """Markdown table.

    `align` has one letter per column, l or r; its last letter holds for all further columns.
    """
    letters = align.ljust(len(header), align[-1])
    rule = "".join("---:|" if letter == "r" else "---|" for letter in letters)
    lines = [f"| {' | '.join(header).lstrip()} |", f"|{rule}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def accuracy(entry: Mapping[str, Any], command: str) -> str:
    """Errors of an entry of certificates.json by kind and by cause, and its steps, best first."""
    c = entry["certificate"]
    reason = f"Chosen for `modes: auto`: {c['reason']}\n\n" if "reason" in c else ""
    return "\n\n".join(
        [
            f"{reason}{sentence(c, c['reach'])} Measured by `{command}`.",
            kinds(c["episodes"]),
            causes(c),
            f"Model: {c['model']}. Reference: {c['reference']}.",
            _heading(c["episodes"]),
            steps(entry["steps"]),
        ]
    )


def sentence(certificate: Mapping[str, Any], reach: float) -> str:
    """The promise of a certificate, of an arm with this reach [m], in words."""
    e = certificate["episodes"]
    times = [
        (level, [kind["until"][k] for kind in e["kinds"].values()])
        for k, level in enumerate(e["levels"])
    ]
    whole = [level for level, until in times if not any(until)]
    if whole:
        share = max(kind["share"] for kind in e["kinds"].values())
        return (
            f"In {round(100 * e['share'])} of 100 whole episodes of every kind the tip stays "
            f"within {1e3 * share * reach:.2g} mm ({share:.1e} of the reach) of the reference."
        )
    bounds = [
        f"within {1e3 * level * reach:.2g} mm ({level:g} of the reach) up to "
        f"{min(t for t in until if t):g} s"
        for level, until in times
    ]
    return (
        f"In {round(100 * e['share'])} of 100 episodes of every kind the tip stays "
        f"{' and '.join(bounds)} of the reference; later it may be anywhere that the motion allows."
    )


def _heading(episodes: Mapping[str, Any]) -> str:
    """The line above the steps; a step is not judged beyond the last of the levels."""
    level = episodes["levels"][-1]
    if all(kind["until"][-1] is None for kind in episodes["kinds"].values()):
        return "Steps that keep the error, the best first:"
    return (
        f"Steps that keep close to the model until it errs by {level:g} of the reach, the best "
        "first. No step is judged later, where motions grow apart; these errors are of whole "
        "episodes, and say little of the step:"
    )


def shown(value: float | None, form: str = ".1e", factor: float = 1.0) -> str:
    """A number of a certificate; None stands for episodes that diverge."""
    return "diverges" if value is None else f"{factor * value:{form}}"


def kinds(episodes: Mapping[str, Any]) -> str:
    """Tip error of whole episodes of each kind."""
    first, second = (f"until {level:g} [s]" for level in episodes["levels"])
    rows = [
        (
            name,
            shown(x["median"]),
            f"{shown(x['share'])} ({' to '.join(map(shown, x['interval']))})",
            shown(x["worst"]),
            f"{x['length']:.2g}",
            *("the end" if t is None else f"{t:.2g}" for t in x["until"]),
            shown(x["growth"], ".2g"),
        )
        for name, x in episodes["kinds"].items()
    ]
    head = (
        "kind", "median [reach]", "95 % [reach]", "worst [reach]", "length [s]", first, second,
        "growth",
    )  # fmt: skip
    return table(head, rows)


def causes(certificate: Mapping[str, Any]) -> str:
    """The 95 % by cause."""
    c = certificate
    names = [name for name, _ in CERTIFICATE]
    rows = [
        (name, shown(c[name], ".2g", 1e3), shown(c[name], ".1e", 1.0 / c["reach"]))
        for name in names
    ]
    return table(("95 % of the worst kind", "tip [mm]", "tip [reach]"), rows)


def steps(found: Iterable[Mapping[str, Any]]) -> str:
    """Measured steps."""
    rows = [
        (x["integrator"], str(x["substeps"]), shown(x["error"]), f"{1e6 * x['seconds']:.2g}")
        for x in found
    ]
    return table(("integrator", "substeps", "95 % [reach]", "CPU time [us]"), rows)
