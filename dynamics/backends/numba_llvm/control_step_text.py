"""Entry point of an environment's generated module: one control step of a batch.

`control_step` is the only entry point because `report` takes long to compile. It steps the
environments of its chunks and returns the number of ended episodes. A negative number means that
actions of the first chunk are not finite; then nothing is stepped. With `substeps` 0 it only
reports on the environments that `rows` lists.
"""

from collections.abc import Iterable, Sequence

from dynamics.backends.numba_llvm.block_text import Routines, block_lines, filled, listed_lines
from dynamics.tracing.statements import ControlStep, Noise, Rows, Statement

_NOISE = """
from dynamics.backends.numba_llvm.noise import normal


@compiled
def noise(w):
    for k in range(np.uint64({count})):
        for b in range(LANES):
            w[{slots} + k * LANES + b] = normal(w[{key} + b], w[{step} + b], k)
"""
# The block of lines in place of a name in braces: `steps` prepares for the length of a substep.
_ENTRY = """
take, put, expect = lane_moves(int(LANES))
take_one, put_one, _ = lane_moves(1, int(LANES))
_, scatter = row_moves(int(LANES))
take_actions, _ = block_moves(int(LANES), int(N_ACTION))
_, put_obs = block_moves(int(LANES), int(N_OBSERVATION))


@outermost
def control_step(rows, thread, substeps, dt, actions, state, w, obs, info, flags):
    width = np.uint64(state.shape[1])
    if substeps == 0:
        count = np.uint64(rows.shape[0])
        for block in range((count + LANES - np.uint64(1)) // LANES):
            first = block * LANES
            {start}
        return np.int64(0)

    ended = np.int64(0)
    flat = actions.reshape(actions.size)
    {steps}
    start, stop = first_chunk(rows, thread)
    while start < stop:
        for k in range(start * N_ACTION, stop * N_ACTION):
            ended -= flat[k] - flat[k] != 0.0
        if ended < 0:
            return ended
        for column in range(start, stop, LANES):
            {step}
        for i in range(start, stop):
            ended += flags[0, i] | flags[1, i]
        start, stop = take_chunk(rows, thread)
    return ended
"""


def control_step_text(entry: ControlStep, routines: Routines, steps: Sequence[str]) -> str:
    """Constants, random numbers and entry point of an environment's module."""
    step = filled(
        _ENTRY,
        start=listed_lines(entry.start, routines),
        steps=steps,
        step=block_lines(entry.step, routines),
    )
    return "\n".join([*row_constants(entry.rows.values()), *noise_text(entry.statements), step])


def row_constants(rows: Iterable[Rows]) -> list[str]:
    """Lines that define how many rows there are of each name, and the first ones."""
    lines = []
    for x in rows:
        lines += [f"N_{x.name} = np.uint64({x.count})"]
        lines += [f"FIRST_{x.name} = np.uint64({x.first})"] if x.first else []
    return lines


def noise_text(statements: Iterable[Statement]) -> list[str]:
    """The function that draws random numbers, if a statement does."""
    noise = next((x for x in statements if isinstance(x, Noise)), None)
    if noise is None:
        return []
    slots, key, step = noise.slots, noise.key, noise.step
    return [_NOISE.format(count=noise.count, slots=slots, key=key, step=step)]
