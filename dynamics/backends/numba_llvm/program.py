"""Generated modules: written once, kept in the cache, run from verified text.

A module is named by a hash of all that determines it: a warm start neither traces nor imports
CasADi, and a changed recursion has another hash, so that it cannot run stale.
"""

import hashlib
import json
import sys
import threading
from collections.abc import Callable, Mapping
from types import ModuleType

from dynamics import cache
from dynamics.backends.numba_llvm.block_text import block_lines
from dynamics.backends.numba_llvm.control_step_text import control_step_text
from dynamics.backends.numba_llvm.derivative_text import derivative_text
from dynamics.backends.numba_llvm.fingerprint import fingerprint
from dynamics.backends.numba_llvm.integrator_text import setting
from dynamics.backends.numba_llvm.module_text import module_text, straight_line_text
from dynamics.backends.numba_llvm.motion_text import motion_text
from dynamics.backends.numba_llvm.stepper_entries import FORCES, step_length, stepper_text
from dynamics.runtime.jit import check_compiler
from dynamics.runtime.numba_internals import DIGEST
from dynamics.tracing import graphs
from dynamics.tracing.assembly import Addition, assembled
from dynamics.tracing.differentiated import differentiated
from dynamics.tracing.function import Function, finite_check, traced
from dynamics.tracing.statements import (
    Call,
    ControlStep,
    Derivatives,
    Load,
    Motion,
    Rows,
    Store,
    Substeps,
)
from dynamics.tracing.traced_arm import TracedArm

STEPPER, INVERSE_DYNAMICS = "stepper", "inverse dynamics"  # loops of `stepper_entries`
SAMPLED = "sampled motion"

_importing = threading.RLock()


def program(
    arm: TracedArm,
    dtype: str,
    lanes: int,
    integrator: str,
    addition: Addition | None = None,
    derivatives: bool = False,
) -> ModuleType:
    """The generated module of an arm for a number of lanes and a method.

    `addition` replaces the stepper's measurements and entry points by others; with `derivatives`,
    derivatives of its control step, or its motion with derivatives, take the place of that.
    """
    added = addition or stepping(arm)
    described = json.dumps(arm.arm.to_dict(), sort_keys=True)
    free = ",".join(arm.free_parameters)
    kind = f"{added.key} derivatives" if derivatives else added.key
    key = fingerprint(described, free, str(lanes), integrator, dtype, arm.formulation, kind)
    return cached_module(key, lambda: generate(arm, dtype, lanes, integrator, added, derivatives))


def generate(
    arm: TracedArm,
    dtype: str,
    lanes: int,
    integrator: str,
    added: Addition,
    derivatives: bool = False,
) -> str:
    """Text of the module of `program`."""
    program = assembled(arm, dtype, lanes, integrator, added)
    program = differentiated(program, arm) if derivatives else program
    method = setting(program.method, block_lines([Call("evaluate")], program.routines))
    steps = step_length(method.prepare)
    if isinstance(program.entry, ControlStep):
        entries = control_step_text(program.entry, program.routines, steps)
    elif isinstance(program.entry, Derivatives):
        entries = derivative_text(program.entry, steps)
    elif isinstance(program.entry, Motion):
        entries = motion_text(program.entry, program.routines, steps)
    elif program.entry == STEPPER:
        columns = [f"N_TORQUE = {arm.n_torque}", f"N_MEASURED = {arm.n_measure}"]
        loops = stepper_text(program.routines, steps, arm.arm.base.spatial)
        entries = "\n".join([*columns, loops])
    else:
        entries = FORCES
    return module_text(
        title=program.title,
        lanes=lanes,
        slots=program.slots,
        operations=(
            len(program.accelerations.lines),
            sum(len(function.lines) for function in program.further),
        ),
        constants=dict(program.at) | {"N": arm.n},
        functions=[straight_line_text(function) for function in program.functions],
        entries="\n".join([*method.text, entries]),
    )


def stepping(arm: TracedArm) -> Addition:
    """A stepper's part: measurements, and a check for numbers that are not finite."""

    def functions(at: Mapping[str, int]) -> list[Function]:
        inputs = [at[name] for name in ("Q", "V", "ATTITUDE") if name in at]
        state = range(at.get("ATTITUDE", at["Q"]), at["V"] + arm.n)
        return [
            traced("measure", graphs.measure(arm), inputs, at["MEASURED"]),
            finite_check(state, at["CHECK"], at["GOOD"]),
        ]

    sizes = {"CHECK": 1, "GOOD": 1, "MEASURED": arm.n_measure}
    return Addition(key=STEPPER, sizes=sizes, functions=functions, entry=STEPPER)


def inverse_dynamics(arm: TracedArm) -> Addition:
    """Generalized forces at many states, in place of a stepper."""

    def functions(at: Mapping[str, int]) -> list[Function]:
        inputs = [at[name] for name in ("Q", "V", "ACC")]
        graph = graphs.generalized_forces(arm)
        return [traced("generalized_forces", graph, inputs, at["FORCES"])]

    sizes = {"FORCES": arm.n}
    return Addition(key=INVERSE_DYNAMICS, sizes=sizes, functions=functions, entry=INVERSE_DYNAMICS)


def sampled(arm: TracedArm) -> Addition:
    """Motions from sample to sample, in place of a stepper."""
    n, free = arm.n, len(arm.free_parameters)
    begin = (
        Load("Q", Rows("COORDINATES", "state", 0, 2 * n)),
        Load("PARAMETERS", Rows("FREE", "state", 2 * n, free)),
    )
    step = (
        Load("TAU", Rows("TORQUE", "torque", 0, arm.n_torque)),
        Call("start"),
        Substeps((Call("step"),)),
        Store("Q", Rows("PLACE", "place", 0, 2 * n)),
    )
    entry = Motion(begin=begin, step=step)
    return Addition(key=SAMPLED, sizes={}, functions=lambda at: [], entry=entry)


def cached_module(key: str, build: Callable[[], str]) -> ModuleType:
    """The generated module of this key; `build` writes its text where the cache has none."""
    check_compiler()
    name = f"flexarm_generated_{key}"
    with _importing:
        if name not in sys.modules:
            sys.modules[name] = _executed(name, cache.kept(f"{name}.py", build))
        return sys.modules[name]


def _executed(name: str, text: str) -> ModuleType:
    """A module made of this very text, which was verified; Python's own cache of code was not."""
    module = ModuleType(name)
    module.__file__ = str(cache.cache_folder() / f"{name}.py")
    module.__dict__[DIGEST] = hashlib.sha256(text.encode()).hexdigest()
    sys.modules[name] = module  # numba looks there for the module of a function
    try:
        exec(compile(text, module.__file__, "exec"), module.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    return module
