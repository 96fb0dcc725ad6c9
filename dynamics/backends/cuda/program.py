"""Kernels of an arm: their text, the numbers they share, and their compiled form."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from dynamics.backends.cuda.kernel_text import DERIVATIVES, START, STEP, kernel_text, shared_slots
from dynamics.integrators.table import INTEGRATORS
from dynamics.tracing.assembly import Addition, Program, assembled
from dynamics.tracing.differentiated import differentiated
from dynamics.tracing.traced_arm import TracedArm
from dynamics.types import Array


@dataclass(frozen=True)
class KernelSource:
    """Text of the kernels, and the program that it prints."""

    text: str
    program: Program
    dtype: str

    def numbers(self, dt: float, given: Mapping[str, Array]) -> Array:
        """(n,) slots that all environments share, for substeps of dt [s].

        `given` are those of the addition, by name; the program may lack some of them.
        """
        program, method = self.program, self.program.method
        w = np.zeros(program.slots)
        w[program.at["H"]] = dt
        if method.aid is not None:
            INTEGRATORS[method.integrator].prepare(w, dt, method.places, method.aid)
        for name, values in given.items():
            if name in program.at:
                w[program.at[name] : program.at[name] + len(values)] = values
        return w[shared_slots(program)].astype(self.dtype)


def generate(
    arm: TracedArm,
    dtype: str,
    integrator: str,
    added: Addition,
    names: Collection[str] = (STEP, START),
) -> KernelSource:
    """Kernels of an arm with an integrator and an environment's addition.

    `names` are of a control step or of its derivatives.
    """
    program = assembled(arm, dtype, 1, integrator, added)
    if DERIVATIVES.issuperset(names):
        program = differentiated(program, arm)
    return KernelSource(kernel_text(program, dtype, names), program, dtype)
