"""Programs of an arm: slots of the workspace, functions and routines, for a backend to print."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

from dynamics.integrators.table import INTEGRATORS, usable
from dynamics.tracing import graphs
from dynamics.tracing.function import Function, traced
from dynamics.tracing.method import Method, traced_method
from dynamics.tracing.statements import Call, ControlStep, Derivatives, Motion, Statements
from dynamics.tracing.traced_arm import TracedArm


@dataclass(frozen=True, kw_only=True)
class Addition:
    """Contents of a program beside an arm's accelerations and its integrator."""

    key: str  # tells it from other additions to the same arm
    sizes: Mapping[str, int]  # further slots of the workspace: name -> how many
    functions: Callable[[Mapping[str, int]], list[Function]]  # of the workspace, from all slots
    entry: ControlStep | Motion | str  # what Python calls; a text names loops of the backend
    shared: Sequence[str] = ()  # names of its slots that are equal in all environments


@dataclass(frozen=True, kw_only=True)
class Program:
    """An arm's program, free of any language."""

    title: str
    sizes: Mapping[str, int]  # slots of the workspace by name, in order
    at: Mapping[str, int]  # first slots by name
    slots: int  # of the workspace
    accelerations: Function
    further: Sequence[Function]  # of the addition
    renewal: Sequence[Function]  # of a free base, after every step
    method: Method
    routines: Mapping[str, Statements]
    entry: ControlStep | Motion | Derivatives | str
    shared: Sequence[str]  # names of slots that are equal in all environments

    @property
    def functions(self) -> list[Function]:
        """All functions, each after those that it needs."""
        return [self.accelerations, *self.further, *self.renewal, *self.method.functions]


def assembled(arm: TracedArm, dtype: str, lanes: int, integrator: str, added: Addition) -> Program:
    """The program of an arm with an integrator and an addition."""
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
    stepped = traced_method(integrator, arm, at, inputs)
    own = added.entry.routines if isinstance(added.entry, ControlStep) else {}
    return Program(
        title=f"{arm.arm.name or 'arm'}, {lanes} lanes, {integrator}, {dtype}",
        sizes=sizes,
        at=at,
        slots=starts[-1],
        accelerations=traced("accelerations", graph, inputs, at["ACC"]),
        further=added.functions(at),
        renewal=_renewal(arm, at),
        method=stepped,
        routines={"evaluate": (Call("accelerations"),), **stepped.routines, **own},
        entry=added.entry,
        shared=["H", *(["SCRATCH"] if stepped.aid is not None else []), *added.shared],
    )


def _renewal(arm: TracedArm, at: Mapping[str, int]) -> list[Function]:
    """The function that follows every step with a free base."""
    if not arm.arm.base.spatial:
        return []
    places = {**at, "GRAVITY": at["PARAMETERS"] + len(arm.free_parameters)}
    graph, sizes = graphs.renewal(arm.arm.gravity)
    inputs = [places[name] for name in list(sizes)[:3]]
    outputs = [places[name] + i for name, size in sizes.items() for i in range(size)]
    return [traced("renew", graph, inputs, outputs)]
