"""Entry point of motions under torques that change at samples.

`steps` (N,) are the lengths of integration steps after each sample but the last. `state` is
(rows, width); `torques` and `places` are (N, rows, width).
"""

from collections.abc import Sequence

from dynamics.backends.numba_llvm.block_text import Routines, block_lines, filled
from dynamics.backends.numba_llvm.control_step_text import row_constants
from dynamics.tracing.statements import Motion, Statements, rows_of

_ENTRY = """
take, put, _ = lane_moves(int(LANES))


@outermost
def follow(steps, substeps, w, {arrays}):
    width = np.uint64(state.shape[1])
    for column in range(np.uint64(0), width, LANES):
        {begin}
        for sample in range(steps.size):
            dt = steps[sample]
            {steps}
            {views}
            {step}
"""


def motion_text(entry: Motion, routines: Routines, steps: Sequence[str]) -> str:
    """Constants and entry point of a module; `steps` are of `step_length`."""
    once, each = _arrays(entry.begin), _arrays(entry.step)
    text = _ENTRY.replace("{arrays}", ", ".join([*once, *(f"{name}s" for name in each)]))
    body = filled(
        text,
        begin=block_lines(entry.begin, routines),
        steps=steps,
        views=[f"{name} = {name}s[sample]" for name in each],
        step=block_lines(entry.step, routines),
    )
    rows = rows_of((*entry.begin, *entry.step)).values()
    return "\n".join([*row_constants(rows), body])


def _arrays(statements: Statements) -> list[str]:
    """Names of the caller's arrays in the order of their first use."""
    return list(dict.fromkeys(rows.array for rows in rows_of(statements).values()))
