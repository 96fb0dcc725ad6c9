"""The control step of an environment as a program: statements that a backend prints.

Functions it calls: `command(w)`, `check(w)` and `report(w)` of `signals`, `place(w)` of an arm on a
floating base, `settle(w)` and `bend(w)` of one that gravity bends, `drop(w)` and `push(w)` of
`happening`, `mark(w)`, `drive(w)` and `follow(w)` of `actuation`; the routines "start" and "step"
of the integrator. An environment that `check` finds lost returns to its state before the step and
is reported there.
"""

from collections.abc import Iterable

from dynamics.tracing.equilibrium import SETTLING
from dynamics.tracing.statements import (
    Call,
    Clear,
    ControlStep,
    Copy,
    Load,
    Noise,
    Prefetch,
    Rows,
    Statement,
    Statements,
    Store,
    Substeps,
    WhereLost,
)
from flexarm_env.compiled import rows as named
from flexarm_env.compiled.actuation import DRIVE, SUBSTEP
from flexarm_env.compiled.happening import CARRIED
from flexarm_env.compiled.termination import FLAGS


def control_step(
    state: named.Rows,
    n_info: int,
    n_observation: int,
    noise: int,
    driven: bool,
    bent: int,
    event: str | None,
) -> ControlStep:
    """Statements of an environment.

    Parameters
    ----------
    state : rows of its state.
    n_info, n_observation : numbers of info and of the observation.
    noise : random numbers per step.
    driven : whether actuators drive the joints, in place of ideal torque sources.
    bent : coordinates that gravity sets at the start of an episode.
    event : name of an event.
    """
    first = {name: rows.start for name, rows in state.slices.items()}
    behind = {name: rows.stop for name, rows in state.slices.items()}

    def of_state(name: str, start: int, stop: int) -> Rows:
        return Rows(name, "state", start, stop - start)

    motion = of_state("STATE", 0, behind["v"])
    memory = of_state("MEMORY", first["action"], first["free"])
    kept = of_state("KEPT", first["action"], first["centre"])
    free = of_state("FREE", first["free"], behind["free"])
    drawn = of_state("DRAWN", behind["free"], state.total)
    target = of_state("TARGET", first["target"], behind["target"])
    actuator = of_state("ACTUATOR", first["actuator"], behind["actuator"])
    readings = of_state("READING", behind["actuator"], first["centre"])
    anchor = of_state("ANCHOR", first["anchor"], behind["anchor"])
    moving = of_state("STATE_AND_MEMORY", 0, first["free"])
    elapsed = of_state("ELAPSED", first["elapsed"], behind["elapsed"])
    actions = Rows("ACTION", "actions", 0, state.sizes["action"])
    flags = Rows("FLAG", "flags", 0, len(FLAGS))
    info = Rows("INFO", "info", 0, n_info)
    observation = Rows("OBSERVATION", "obs", 0, n_observation)

    random = Noise("NOISE", noise, "DRAWN", "ELAPSED")
    state_loads = (Load("Q", motion), Load("ACTION", memory))
    parameters = Load(CARRIED if event == "drop" else "PARAMETERS", free)
    drop = (event == "drop") * (Call("drop"),)
    placed = anchor.count or bent  # the parameters place the arm at its start
    bend = (Clear("REST", bent), *SETTLING * (Call("settle"),), Call("bend"),
            Store("Q", motion), Store("ELAPSED", elapsed), Store("ACTUATOR", actuator))  # fmt: skip
    results = (Store("FLAGS", flags), Store("INFO", info), Store("OBSERVATION", observation))
    start = (
        *state_loads,
        *((parameters,) if placed else ()),
        Load("DRAWN", drawn),
        *(drop if placed else ()),
        *(bend if bent else ()),
        Copy("ACTION", "BEFORE", actions),
        Clear("LOST"),
        *((Call("place"),) if anchor.count else ()),
        random,
        Call("report"), Call("check"), Call("report"),
        Store("TARGET_NOW", target),
        Store("READINGS_NOW", readings),
        Store("ANCHOR", anchor),
        *results,
    )  # fmt: skip
    restored = (Load("Q", motion), *((Load("ACTUATOR", actuator),) if actuator.count else ()))
    substeps = (Substeps(SUBSTEP),) if driven else (Call("start"), Substeps((Call("step"),)))
    step = (
        Prefetch(info),
        Prefetch(observation),
        *state_loads,
        parameters,
        Load("DRAWN", drawn),
        Load("GIVEN", actions),
        Call("command"),
        random,
        *drop,
        *substeps,
        Call("report"),
        Prefetch(moving, next=True),
        Call("check"),
        WhereLost(
            "LOST",
            restored=restored,
            then=(Call("report"),),
            given=(("ACTION", actions.count), ("TAU", actions.count)),
        ),
        Copy("TARGET_NOW", "TARGET", target),
        Copy("READINGS_NOW", "ANGLES", readings),
        Store("Q", motion),
        Store("ACTION", kept),
        *results,
    )
    evaluation = (*driven * DRIVE, Call("accelerations"), *(event == "push") * (Call("push"),))
    routines: dict[str, Statements] = {"evaluate": evaluation} if len(evaluation) > 1 else {}
    return ControlStep(step=tuple(_present(step)), start=tuple(_present(start)), routines=routines)


def _present(statements: Iterable[Statement]) -> Iterable[Statement]:
    """Statements that move something."""
    for statement in statements:
        match statement:
            case Load(_, rows) | Store(_, rows) | Copy(_, _, rows) if not rows.count:
                continue
            case Noise(count=0):
                continue
        yield statement
