"""Published numbers of the presets; the files of `dynamics/arms/presets` hold arms and numbers."""

from benchmarks.validation.entries import Number, Table
from dynamics.arms import ARMS, CHECKS

CHAPTER = "Presets"
NOTES = {
    CHAPTER: "What every preset is held to (`dynamics/arms`, `python -m dynamics list`); the "
    "remark names the source."
}


def tables() -> list[Table]:
    """One table per preset."""
    return [
        Table(
            chapter=CHAPTER, title=name,
            demand="within " + ", ".join(sorted({f"{100.0 * c.tolerance:.2g} %" for c in checks})),
            rows=tuple(
                Number(
                    quantity=check.quantity, printed=f"{check.expected:.10g}", unit=check.unit,
                    within=check.tolerance * abs(check.expected), remark=check.source,
                )
                for check in checks
            ),
            ours=lambda n=name: [  # type: ignore[misc]
                check.measure(ARMS[n]) for check in CHECKS[n]
            ],
        )
        for name, checks in CHECKS.items()
    ]  # fmt: skip
