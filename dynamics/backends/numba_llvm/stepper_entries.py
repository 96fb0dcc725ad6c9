"""Entry points of a stepper's generated module: loops over blocks of environments.

They are text because numba compiles functions of a module, and the functions that they call are
the module's own: `accelerations(w)`, `measure(w)` and `check(w)` of the arm, the straight-line
functions of the integrator. `python -m dynamics source ARM` prints the result.
"""

from collections.abc import Sequence

from dynamics.backends.numba_llvm.block_text import Routines, block_lines, filled
from dynamics.tracing.statements import Call, Clear, Substeps

LANES = 16  # of a batch's blocks in float64; twice as many fit the same registers in float32
LANES_OF = {"float64": LANES, "float32": 2 * LANES}

# The block of lines in place of a name in braces.
# w[H] is the step length that w was prepared for, zero at first
_STEPS = """
h = w.dtype.type(dt)
if w[H] != h:
    for b in range(LANES):
        w[H + b] = h
    {prepare}
"""
_ENTRIES = """
gather, scatter = row_moves(int(LANES))
take_states, put_states = block_moves(int(LANES), int(N // LANES))
take_torques, _ = block_moves(int(LANES), N_TORQUE)
_, put_measured = block_moves(int(LANES), N_MEASURED)


@outermost
def advance(rows, thread, q, v, torque, parameters, dt, substeps, w, status, measured):
    {steps}
    start, stop = first_chunk(rows, thread)
    while start < stop:
        for first in range(start, stop, LANES):
            take_states(w, Q, q, first)
            take_states(w, V, v, first)
            take_torques(w, TAU, torque, first)
            gather(w, PARAMETERS, parameters, first)
            {advance}
            kept = 0
            for b in range(LANES):
                kept += np.int64(w[GOOD + b]) == substeps
            if kept == LANES:
                put_states(w, Q, q, first)
                put_states(w, V, v, first)
                put_measured(w, MEASURED, measured, first)
                status[first : first + LANES] = 0
                continue
            for b in range(min(LANES, stop - first)):
                row = first + b
                good = np.int64(w[GOOD + b])
                if good == substeps:
                    status[row] = 0
                    scatter(w, Q + b, q, row)
                    scatter(w, V + b, v, row)
                    scatter(w, MEASURED + b, measured, row)
                else:
                    status[row] = good + 1
        start, stop = take_chunk(rows, thread)


@outermost
def measure_states(q, v, w, out):
    rows = np.uint64(q.shape[0])
    for block in range((rows + LANES - np.uint64(1)) // LANES):
        first = block * LANES
        gather(w, Q, q, first)
        gather(w, V, v, first)
        {enter}
        measure(w)
        for b in range(min(LANES, rows - first)):
            scatter(w, MEASURED + b, out, first + b)


@outermost
def evaluate_states(q, v, torque, parameters, w, out):
    rows = np.uint64(q.shape[0])
    for at in range(IMPLICIT, ACC):
        w[at] = 0.0
    for block in range((rows + LANES - np.uint64(1)) // LANES):
        first = block * LANES
        gather(w, Q, q, first)
        gather(w, V, v, first)
        gather(w, TAU, torque, first)
        gather(w, PARAMETERS, parameters, first)
        {enter}
        accelerations(w)
        {result}
        for b in range(min(LANES, rows - first)):
            scatter(w, ACC + b, out, first + b)


@outermost
def evaluate_often(w, times):
    for _ in range(times):
        accelerations(w)
"""
# of an addition without steps: `generalized_forces(w)` at many states
FORCES = """
gather, scatter = row_moves(int(LANES))


@outermost
def forces_of_states(q, v, a, w, out):
    rows = np.uint64(q.shape[0])
    for block in range((rows + LANES - np.uint64(1)) // LANES):
        first = block * LANES
        gather(w, Q, q, first)
        gather(w, V, v, first)
        gather(w, ACC, a, first)
        generalized_forces(w)
        for b in range(min(LANES, rows - first)):
            scatter(w, FORCES + b, out, first + b)
"""
# conversions of a free base's state, see formulations/free_base.py
_ENTER = ("enter(w, LANES, Q, V, ATTITUDE)", "renew(w)")
_LEAVE = ("leave(w, LANES, Q, V, ATTITUDE)",)
_RESULT = ("turn(w, LANES, ACC, ATTITUDE, 1.0)",)


def step_length(prepare: Sequence[str]) -> list[str]:
    """Lines that store a new step length, and prepare the method for it."""
    return filled(_STEPS, prepare=prepare).strip().splitlines()


def stepper_text(routines: Routines, steps: Sequence[str], spatial: bool) -> str:
    """Entry points; `steps` are the lines of `step_length`, `spatial` is of a free base."""
    enter, leave, result = (_ENTER, _LEAVE, _RESULT) if spatial else ((), (), ())
    renew = (Call("renew"),) if spatial else ()
    counted = Substeps((Call("step"), *renew, Call("check")))
    lines = block_lines((Clear("CHECK"), Clear("GOOD"), Call("start"), counted), routines)
    advance = [*enter, *lines, "measure(w)", *leave]
    return filled(_ENTRIES, steps=steps, advance=advance, enter=enter, result=result)
