"""Tables of a certificate and of measured steps, as on the page of an environment."""

from collections.abc import Iterable, Sequence
from typing import Any

CERTIFICATE = (
    ("error", "model and step together, from the reference"),
    ("integration", "the step alone, from converged integration of the model"),
    ("truncation", "the model from the rich model"),
    ("nonlinear", "the rich model from the reference"),
    ("residual", "the reference: tip displacement by its last refinement"),
)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Markdown table."""
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def accuracy(certificate: dict[str, Any], steps: Iterable[dict[str, Any]]) -> str:
    """Errors of a certificate, its model and reference, and the measured steps, best first."""
    c = certificate
    errors = [
        (name, f"{1e3 * c[name]:.2g}", f"{c[name] / c['reach']:.1e}") for name, _ in CERTIFICATE
    ]
    rows = [
        (
            x["integrator"],
            str(x["substeps"]),
            f"{x['error']:.1e}",
            f"{x['episode_error']:.1e}",
            f"{1e6 * x['seconds']:.2g}",
        )
        for x in steps
    ]
    reason = f"Chosen for `modes: auto`: {c['reason']}\n\n" if "reason" in c else ""
    return (
        f"{reason}Certificate (`{c['reproduce']}`):\n\n"
        + markdown(("error", "tip [mm]", "tip [reach]"), errors)
        + f"\n\nModel: {c['model']}. Reference: {c['reference']}.\n\nMeasured steps:\n\n"
        + markdown(
            ("integrator", "substeps", "in all [reach]", "step alone, episodes", "CPU time [us]"),
            rows,
        )
    )
