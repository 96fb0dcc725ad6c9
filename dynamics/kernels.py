"""The compiled loops around an arm's own code, on the flat workspace that lowering.py describes.

A generated module holds `accelerations(w)` and `measure(w)` of one arm for one number of lanes,
imports the small loops from here and ends with its entry points, `glue`.
"""

import numpy as np
from numba import njit

__all__ = ["LANES", "compiled", "count_finite", "gather", "glue", "outermost", "scatter"]

LANES = 16  # of a batch's blocks in float64; twice as many fit the same registers in float32

_FAST = {"fastmath": {"contract", "arcp", "nsz"}, "error_model": "numpy", "nogil": True}
compiled = njit(**_FAST, inline="always")
outermost = njit(**_FAST, cache=True)  # what Python calls: cached on disk


@compiled
def gather(rows, first, count, lanes, w, at):  # type: ignore[no-untyped-def]
    """Rows of environments into workspace lanes; idle lanes repeat the last environment."""
    for b in range(lanes):
        row = first + min(b, count - np.uint64(1))
        for i in range(np.uint64(rows.shape[1])):
            w[at + i * lanes + b] = rows[row, i]


@compiled
def scatter(w, at, lanes, b, row, rows):  # type: ignore[no-untyped-def]
    """One lane of the workspace into its environment's row."""
    for i in range(np.uint64(rows.shape[1])):
        rows[row, i] = w[at + i * lanes + b]


@compiled
def count_finite(w, lanes, first, stop, check, good):  # type: ignore[no-untyped-def]
    """Add one to `good` of each lane whose values, this time and before, are all finite."""
    for at in range(first, stop, lanes):
        for b in range(lanes):
            w[check + b] += w.dtype.type(0.0) * w[at + b]
    for b in range(lanes):
        finite = w[check + b] == w.dtype.type(0.0)
        w[good + b] += w.dtype.type(1.0 if finite else 0.0)


# What a generated module adds to its arm's `accelerations(w)`, `measure(w)` and its method's
# `start(w, evaluate)` and `step(w, evaluate)`; the marks are for a free base, whose `renew(w)`
# comes with the arm: see free_base.py and chart.py.
_GLUE = """
@compiled
def advance_lanes(block, q, v, torque, parameters, dt, substeps, w, status, measured):
    first = block * LANES
    count = min(LANES, np.uint64(q.shape[0]) - first)
    gather(q, first, count, LANES, w, Q)
    gather(v, first, count, LANES, w, V)
    gather(torque, first, count, LANES, w, TAU)
    gather(parameters, first, count, LANES, w, PARAMETERS)
    #enter
    for b in range(LANES):
        w[CHECK + b] = 0.0
        w[GOOD + b] = 0.0
        w[H + b] = dt
    start(w, accelerations)
    for _ in range(substeps):
        step(w, accelerations)
        #renew
        count_finite(w, LANES, #first, V + N, CHECK, GOOD)
    measure(w)
    #leave
    for b in range(count):
        row = first + b
        good = np.int64(w[GOOD + b])
        if good == substeps:
            status[row] = 0
            scatter(w, Q, LANES, b, row, q)
            scatter(w, V, LANES, b, row, v)
            scatter(w, MEASURED, LANES, b, row, measured)
        else:
            status[row] = good + 1


@outermost
def advance(q, v, torque, parameters, dt, substeps, w, status, measured):
    blocks = (np.uint64(q.shape[0]) + LANES - np.uint64(1)) // LANES
    for block in range(blocks):
        advance_lanes(block, q, v, torque, parameters, dt, substeps, w, status, measured)


@outermost
def measure_states(q, v, w, out):
    rows = np.uint64(q.shape[0])
    for block in range((rows + LANES - np.uint64(1)) // LANES):
        first = block * LANES
        count = min(LANES, rows - first)
        gather(q, first, count, LANES, w, Q)
        gather(v, first, count, LANES, w, V)
        #enter
        measure(w)
        for b in range(count):
            scatter(w, MEASURED, LANES, b, first + b, out)


@outermost
def evaluate_states(q, v, torque, parameters, w, out):
    rows = np.uint64(q.shape[0])
    for b in range(LANES):
        for at in range(IMPLICIT, ACC, LANES):
            w[at + b] = 0.0
    for block in range((rows + LANES - np.uint64(1)) // LANES):
        first = block * LANES
        count = min(LANES, rows - first)
        gather(q, first, count, LANES, w, Q)
        gather(v, first, count, LANES, w, V)
        gather(torque, first, count, LANES, w, TAU)
        gather(parameters, first, count, LANES, w, PARAMETERS)
        #enter
        accelerations(w)
        #result
        for b in range(count):
            scatter(w, ACC, LANES, b, first + b, out)


@outermost
def evaluate_often(w, times):
    for _ in range(times):
        accelerations(w)
"""

_MARKS = {
    "#enter": "enter(w, LANES, Q, V, ATTITUDE)\nrenew(w)",
    "#renew": "renew(w)",
    "#leave": "leave(w, LANES, Q, V, ATTITUDE)",
    "#result": "turn(w, LANES, ACC, ATTITUDE, 1.0)",
}


def glue(free_base: bool) -> str:
    """Text of a module's entry points."""
    lines = []
    for line in _GLUE.replace("#first", "ATTITUDE" if free_base else "Q").splitlines():
        bare = line.lstrip()
        if bare not in _MARKS:
            lines.append(line)
        elif free_base:
            indent = line[: len(line) - len(bare)]
            lines += [indent + own for own in _MARKS[bare].splitlines()]
    head = "from dynamics.chart import enter, leave, turn\n" if free_base else ""
    return head + "\n".join(lines) + "\n"
