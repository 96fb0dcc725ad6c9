"""Entry points of the derivatives of a control step; see `tracing.differentiated`.

Each steps the environments of its chunks; arrays are as those of `control_step`, and the mirrors of
arrays have their shapes. `stack` is (rows, width).
"""

from collections.abc import Sequence

from dynamics.backends.numba_llvm.block_text import block_lines, filled
from dynamics.backends.numba_llvm.control_step_text import noise_text, row_constants
from dynamics.tracing.statements import Derivatives, Statements, rows_of, walked

_MOVES = """
take, put, expect = lane_moves(int(LANES))
take_one, put_one, _ = lane_moves(1, int(LANES))
take_actions, put_actions = block_moves(int(LANES), int(N_ACTION))
take_obs, put_obs = block_moves(int(LANES), int(N_OBSERVATION))
take_actions_mirror, put_actions_mirror = take_actions, put_actions
take_obs_mirror, put_obs_mirror = take_obs, put_obs
"""
_ENTRY = """
@outermost
def {name}({arguments}):
    width = np.uint64(state.shape[1])
    {steps}
    start, stop = first_chunk(rows, thread)
    while start < stop:
        for column in range(start, stop, LANES):
            top = np.uint64({top})
            {body}
        start, stop = take_chunk(rows, thread)
"""
_GIVEN = "rows, thread, substeps, dt, actions, state, w"
_STORED = "obs, info, flags"
_MIRRORS = "actions_mirror, state_mirror, obs_mirror, info_mirror"


def derivative_text(entry: Derivatives, steps: Sequence[str]) -> str:
    """Constants, random numbers and entry points of a module; `steps` are of `step_length`."""
    entries = {
        "record": (entry.record, f"{_GIVEN}, {_STORED}, stack", "0"),
        "pull_back": (entry.pull_back, f"{_GIVEN}, stack, {_MIRRORS}", "stack.shape[0]"),
        "push_forward": (entry.push_forward, f"{_GIVEN}, {_STORED}, {_MIRRORS}", "0"),
    }
    every = [x for statements, _, _ in entries.values() for x in walked(statements)]
    parts = [
        *row_constants(rows_of(every).values()),
        f"STACK = {entry.fixed}, {entry.per_substep}",
        *noise_text(every),
        _MOVES,
    ]
    for name, (statements, arguments, top) in entries.items():
        parts.append(_entry(name, statements, arguments, top, steps))
    return "\n".join(parts)


def _entry(
    name: str, statements: Statements, arguments: str, top: str, steps: Sequence[str]
) -> str:
    text = _ENTRY.replace("{name}", name).replace("{arguments}", arguments).replace("{top}", top)
    return filled(text, steps=steps, body=block_lines(statements, {}))
