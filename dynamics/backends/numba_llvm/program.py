"""Generated modules: written once, kept in the cache, run from verified text.

A module is named by a hash of all that determines it: a warm start neither traces nor imports
CasADi, and a changed recursion has another hash, so that it cannot run stale.
"""

import hashlib
import json
import sys
import threading
from collections.abc import Callable, Mapping
from itertools import accumulate
from types import ModuleType

from dynamics import cache
from dynamics.backends.numba_llvm.fingerprint import fingerprint
from dynamics.backends.numba_llvm.integrator_text import method_text
from dynamics.backends.numba_llvm.module_text import (
    Addition,
    expanded,
    module_text,
    straight_line_text,
)
from dynamics.backends.numba_llvm.stepper_entries import ENTRIES, FORCES, FREE_BASE, STEPS
from dynamics.integrators.table import INTEGRATORS, usable
from dynamics.runtime.numba_internals import DIGEST
from dynamics.tracing import graphs
from dynamics.tracing.function import Function, finite_check, traced
from dynamics.tracing.traced_arm import TracedArm

_importing = threading.RLock()


def program(
    arm: TracedArm, dtype: str, lanes: int, integrator: str, addition: Addition | None = None
) -> ModuleType:
    """The generated module of an arm for a number of lanes and a method.

    `addition` replaces the stepper's measurements and entry points by others.
    """
    added = addition or stepping(arm)
    described = json.dumps(arm.arm.to_dict(), sort_keys=True)
    free = ",".join(arm.free_parameters)
    key = fingerprint(described, free, str(lanes), integrator, dtype, arm.formulation, added.key)
    return cached_module(key, lambda: generate(arm, dtype, lanes, integrator, added))


def generate(arm: TracedArm, dtype: str, lanes: int, integrator: str, added: Addition) -> str:
    """Text of the module of `program`."""
    method = INTEGRATORS[integrator]
    others = usable(arm.n, arm.arm.base.spatial)
    if integrator not in others:
        raise ValueError(
            f"integrator {integrator!r} remembers earlier steps, but a free base has new "
            f"coordinates after every step; take one of {others}."
        )
    graphs.check_rest(arm)
    sizes = {
        **({"ATTITUDE": 4} if arm.arm.base.spatial else {}),
        "Q": arm.n, "V": arm.n, "TAU": arm.n_torque,
        "PARAMETERS": len(arm.free_parameters) + arm.n_gravity,
        "IMPLICIT": 3 * arm.n * method.implicit, "ACC": arm.n, "H": 1,
        "SCRATCH": method.scratch(arm.n),
        **added.sizes,
    }  # fmt: skip
    starts = list(accumulate(sizes.values(), initial=0))
    at = dict(zip(sizes, starts, strict=False))
    inputs = [at[name] for name in ("Q", "V", "TAU", "PARAMETERS", "IMPLICIT")]
    graph = graphs.accelerations(arm, method.implicit)
    own = traced("accelerations", graph, inputs, at["ACC"])
    further = added.functions(at)
    stepped = method_text(integrator, arm, at, inputs)
    free_base = FREE_BASE if arm.arm.base.spatial else dict.fromkeys(FREE_BASE, ())
    marks = {
        "#evaluate": ["accelerations(w)"], **STEPS, **stepped.marks, **free_base, **added.marks,
    }  # fmt: skip
    return module_text(
        title=f"{arm.arm.name or 'arm'}, {lanes} lanes, {integrator}, {dtype}",
        lanes=lanes,
        slots=starts[-1],
        operations=(len(own.lines), sum(len(function.lines) for function in further)),
        constants=at | {"N": arm.n},
        functions=[
            straight_line_text(function)
            for function in (own, *further, *_renewal(arm, at), *stepped.functions)
        ],
        entries=expanded("\n".join([*stepped.setting, added.entries]), marks),
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
    columns = [f"N_TORQUE = {arm.n_torque}", f"N_MEASURED = {arm.n_measure}"]
    entries = "\n".join([*columns, ENTRIES])
    return Addition(key="stepper", sizes=sizes, functions=functions, entries=entries)


def inverse_dynamics(arm: TracedArm) -> Addition:
    """Generalized forces at many states, in place of a stepper."""

    def functions(at: Mapping[str, int]) -> list[Function]:
        inputs = [at[name] for name in ("Q", "V", "ACC")]
        graph = graphs.generalized_forces(arm)
        return [traced("generalized_forces", graph, inputs, at["FORCES"])]

    sizes = {"FORCES": arm.n}
    return Addition(key="inverse dynamics", sizes=sizes, functions=functions, entries=FORCES)


def _renewal(arm: TracedArm, at: Mapping[str, int]) -> list[Function]:
    """The function that follows every step with a free base."""
    if not arm.arm.base.spatial:
        return []
    places = {**at, "GRAVITY": at["PARAMETERS"] + len(arm.free_parameters)}
    graph, sizes = graphs.renewal(arm.arm.gravity)
    inputs = [places[name] for name in list(sizes)[:3]]
    outputs = [places[name] + i for name, size in sizes.items() for i in range(size)]
    return [traced("renew", graph, inputs, outputs)]


def cached_module(key: str, build: Callable[[], str]) -> ModuleType:
    """The generated module of this key; `build` writes its text where the cache has none."""
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
