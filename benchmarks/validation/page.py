"""Markdown page of the validation results."""

from typing import Any

from benchmarks.output import table
from benchmarks.validation.entries import VERDICTS

MEANING = {
    "reproduced": "our number meets the demand stated with its table",
    "error in print": "our number differs from the printed one and agrees with its correction",
    "replaced": "the source's method or data fail or are lost; the remark names ours",
    "lost in source": "the source lacks information that the comparison needs",
    "not comparable": "shown side by side, but the quantities differ",
    "not reproduced": "our number does not meet the demand",
}
FIGURES = (
    ("validation_slim_step.png", "SLIM's step under joint PD: joint angle, strain at base and mid"),
    ("validation_lyapunov.png", "The theorem's function V, and V(0) less the work of K_D"),
    ("validation_held_free.png", "SLIM's frequencies from a free to a locked joint"),
    ("validation_release.png", "Korayem's arm released: tip deflections, and the tabulated ones"),
)
HONESTY = (  # source, its statement or gap, kind, treatment here
    ("Korayem 2009", "(70) drops ω × θ̇, (69) drops ω̇_v × r, (44) has a wrong sign",
     "error in print", "corrected; see [theory](theory.md)"),
    ("Korayem 2009", "rotation of a bent tip 1 + θ̃, with θ̇ as its rate: energy is not kept in 3-D",
     "replaced", 'exp(θ̃) with its exact rate; `rotation="linear"` keeps the print'),
    ("Korayem 2009", "first case of table 2 labelled m = 3", "error in print",
     "its counts are those of m = 2"),
    ("Korayem 2009", "figures without tables; section of the links", "lost in source",
     "an independent implementation's numbers; only EI and mass per length count"),
    ("Korayem 2009", "one clamped-free mode on a free joint: 36.2 Hz, true 26.0", "replaced",
     "two modes in the preset; one is in the tables"),
    ("Book", "drops a second-order term of the inertia", "replaced", "kept"),
    ("Book", "12 009 multiplications", "error in print", "its formula gives 11 361"),
    ("Book", "simulation results", "lost in source", "none are printed"),
    ("Cyril, thesis", "chapters 4 to 7: flexible formulation, tables 6.1, 6.2, 7.1 to 7.5, "
     "trajectories (2.15), (7.1) to (7.3)", "lost in source",
     "nothing here is called a number of the thesis"),
    ("Cyril, thesis", "two hanging links", "replaced", "Korayem's data: same figures, same start"),
    ("Cyril, thesis", "CANADARM data", "replaced",
     "`srms-like`: public geometry and mass; EI and joint springs tuned to 0.35, 0.46, 3.554 and "
     "4.228 Hz"),
    ("Yuan 1993", "SLIM's density, tip mass, hub, gains", "lost in source",
     "density and tip body fitted to the printed modes 1, 2, 4, 5; hub and gains chosen"),
    ("Yuan 1993", "SLIM's third frequency, 41.524 Hz", "error in print",
     "40.52 Hz follows from the data that give the other four"),
    ("Yuan 1993", "EI in lbf in⁴, K_D = diag[K_P], EG for GJ", "error in print",
     "lbf in², diag[K_D], GJ"),
    ("Yuan 1993", "RALF's sections, joints, lever arms; a damping ratio of 0.2 or 0.02; a digit "
     "of (7.1a)", "lost in source", "`ralf-like`: printed length, mass, parallel drive; "
     "EI tuned; tables shown"),
    ("Zohoor 2009", "numbers of any kind", "lost in source", "limit equations as frequencies"),
    ("Zohoor 2009", "a strain that changes under rigid rotation: first bending of Korayem's link "
     "at 485 Hz instead of 7.9", "replaced",
     "linear bending and torsion on welded, foreshortened segments"),
)  # fmt: skip


def page(results: dict[str, Any]) -> str:
    """The page as Markdown."""
    tables = results["tables"]
    lines = [
        "# Validation", "",
        "Published numbers compared with ours. All of ours were computed by", "",
        f"```\n{results['command']}\n```", "",
        "which writes this page, its [data](results/validation.json) and its pictures. The tests "
        "run its short form, `--quick`, and fail if a verdict changes. *Theirs* is the published "
        "number; deviations of ours are in per cent of it.", "",
        *_summary(tables),
        "## Lost, replaced, wrong in print", "",
        table(["source", "what", "kind", "here"], HONESTY), "",
        "## Pictures", "",
    ]  # fmt: skip
    for file, caption in FIGURES:
        lines += [f"![{caption}](results/{file})", "", f"*{caption}.*", ""]
    chapter = None
    for entry in tables:
        if entry["chapter"] != chapter:
            chapter = entry["chapter"]
            lines += [f"## {chapter}", "", results["notes"][chapter], ""]
        lines += _details(entry)
    return "\n".join(lines)


def _summary(tables: list[dict[str, Any]]) -> list[str]:
    chapters = list(dict.fromkeys(table["chapter"] for table in tables))
    found = [verdict for verdict in VERDICTS if _count(tables, verdict)]
    rows = []
    for chapter in chapters:
        own = [entry for entry in tables if entry["chapter"] == chapter]
        counts = [str(_count(own, verdict) or "") for verdict in found]
        rows.append([f"[{chapter}](#{_anchor(chapter)})", *counts])
    rows.append(["all", *(f"**{_count(tables, verdict)}**" for verdict in found)])
    meanings = [f"- *{verdict}*: {MEANING[verdict]}." for verdict in found]
    return [table(["", *found], rows, "lr"), "", *meanings, ""]


def _count(tables: list[dict[str, Any]], verdict: str) -> int:
    return sum(row["verdict"] == verdict for entry in tables for row in entry["rows"])


def _anchor(title: str) -> str:
    kept = [c for c in title.lower() if c.isalnum() or c in " -"]
    return "".join(kept).replace(" ", "-")


def _details(entry: dict[str, Any]) -> list[str]:
    """A folded table; the column of remarks is left out if it is empty."""
    verdicts = ", ".join(f"{_count([entry], v)} {v}" for v in VERDICTS if _count([entry], v))
    header = ["quantity", "unit", "theirs", "ours", "deviation", "verdict", "remark"]
    rows = [
        [
            row["quantity"], row["unit"], row["theirs"] or "–", shown(row["ours"], row["theirs"]),
            deviation(row), row["verdict"], row["remark"],
        ]
        for row in entry["rows"]
    ]  # fmt: skip
    width = 7 if any(row["remark"] for row in entry["rows"]) else 6
    return [
        "<details>", f"<summary>{entry['title']}: {verdicts}</summary>", "",
        f"Demand: {entry['demand']}.", "",
        table(header[:width], [row[:width] for row in rows], "llrrrl"),
        "", "</details>", "",
    ]  # fmt: skip


def shown(ours: float | None, printed: str) -> str:
    """Our number with two more digits than the print."""
    if ours is None:
        return "–"
    if printed and float(printed) == 0.0:
        return f"{ours:.1e}"
    mantissa = printed.lower().partition("e")[0].lstrip("-0.").replace(".", "")
    return f"{ours:.{max(3, len(mantissa) + 2)}g}"


def deviation(row: dict[str, Any]) -> str:
    """Deviation in per cent of the printed number; absolute if that is zero."""
    if row["deviation"] is None:
        return "–"
    theirs = float(row["theirs"])
    if theirs == 0.0:
        return f"{row['deviation']:+.1e}"
    share = 100.0 * row["deviation"] / abs(theirs)
    return "0" if abs(share) < 5e-8 else f"{share:+.2g} %"
