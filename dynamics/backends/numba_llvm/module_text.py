"""Text of a generated module: straight-line functions, constants, entry points."""

import textwrap
from collections.abc import Mapping, Sequence

from dynamics.tracing.function import Function

_IMPORTS = """
import numpy as np
from dynamics.backends.numba_llvm.free_base_entries import enter, leave, turn
from dynamics.runtime.jit import compiled, outermost
from dynamics.backends.numba_llvm.integrator_text import INTEGRATORS, preparation
from dynamics.backends.numba_llvm.lanes import block_moves, lane_moves, row_moves, straight_line
from dynamics.runtime.work_queue import first_chunk, take_chunk
from dynamics.integrators.exponential import FrozenModes
from dynamics.integrators.slots import Slots
"""


def straight_line_text(function: Function) -> str:
    """Definition of a function for `vector_code.straight_line` to compile."""
    loose = ", loose=True" if function.loose else ""
    name = function.name
    head, end = f'{name} = straight_line("{name}", LANES, """', f'"""{loose})\n'
    return "\n".join([head, *function.lines, end])


def module_text(
    title: str,
    lanes: int,
    slots: int,
    operations: tuple[int, int],
    constants: Mapping[str, int],
    functions: Sequence[str],
    entries: str,
) -> str:
    """The whole module.

    Parameters
    ----------
    title : any text; a description's name is in it.
    slots : number of slots of the workspace.
    operations : of an evaluation of the accelerations, and of the addition.
    constants : slots by name; in the module they are offsets, lanes counted.
    functions, entries : text of the functions of the workspace, and of those that Python calls.
    """
    head = [
        '"""Generated code of one arm; see dynamics/backends/numba_llvm."""',
        f"TITLE = {title!a}",  # no other text of a description becomes source
        _IMPORTS,
        f"LANES = {lanes}",
        f"SLOTS = {slots}",
        f"OPERATIONS = {operations[0]}",
        f"FURTHER_OPERATIONS = {operations[1]}",
    ]
    head += _slot_table(slots, constants)
    offsets = [f"{name} = np.uint64({slot * lanes})" for name, slot in constants.items()]
    lines = [f"LANES = np.uint64({lanes})", *offsets]
    return "\n\n".join(["\n".join(head), *functions, "\n".join(lines), entries])


def _slot_table(slots: int, first: Mapping[str, int]) -> list[str]:
    """Comment that names the slots of the workspace."""
    starts = [(name, slot) for name, slot in first.items() if name != "N"]
    ends = [slot for _, slot in starts[1:]] + [slots]
    runs = [f"{a}:{b} {name}" for (name, a), b in zip(starts, ends, strict=True) if a < b]
    text = f"Slots of the workspace w, LANES numbers each: {', '.join(runs)}."
    return textwrap.wrap(text, 98, initial_indent="# ", subsequent_indent="# ")
