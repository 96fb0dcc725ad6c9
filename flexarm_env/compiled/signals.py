"""Observation, reward, info and flags of an environment, compiled with the physics of its arm.

One description serves all arms and tasks. Signals that a task or an observation does not use are
not compiled. Numbers that keywords change without changing the structure are constants of the
workspace.
"""

from collections.abc import Mapping
from functools import reduce
from pathlib import Path
from typing import Any

from dynamics.backends.numba_llvm.fingerprint import hash_of_files
from dynamics.model import Model
from dynamics.tracing import graphs
from dynamics.tracing.assembly import Addition
from dynamics.tracing.equilibrium import SETTLED, bent_coordinates, settling
from dynamics.tracing.function import Function, traced
from dynamics.types import Symbols
from flexarm_env.compiled.actuation import Actuation, command
from flexarm_env.compiled.control_step import control_step
from flexarm_env.compiled.episode import WAVES
from flexarm_env.compiled.happening import Happening
from flexarm_env.compiled.rows import Rows
from flexarm_env.compiled.sensing import Sensing
from flexarm_env.compiled.termination import FLAGS, cost, flags, lost
from flexarm_env.task.observations import Layout, curvature_columns
from flexarm_env.task.rewards import TERMS, Measured
from flexarm_env.task.tasks import SETTLED_BAND

NUMBERS = ("time", "tip_error", "tip_speed", "deflection", "tip_deflection")  # one row of info each
# hash, at import, of the sources that determine the compiled code besides those of `dynamics`
_HERE = Path(__file__).parent
_TASK = _HERE.with_name("task")
_SOURCES = hash_of_files([*_HERE.glob("*.py"), *_TASK.glob("*.py")])


class Signals:
    """Signals of an arm with a task: their rows, and the functions that compute them.

    Attributes
    ----------
    state : rows of an environment's state, for `episode.begin` and `control_step`.
    memory : rows of the state between "v" and "free", with their sizes.
    drawn : rows of the state behind "free", drawn at every reset, with their sizes.
    info : rows of the reward and the info entries.
    constants : rows of the numbers that all environments share.
    gauges : columns of the model's "curvature" that info reports.
    bent : coordinates that gravity sets at the start of an episode.
    """

    def __init__(
        self,
        model: Model,
        moving: bool,
        layout: Layout,
        actuation: Actuation | None = None,
        sensing: Sensing | None = None,
        happening: Happening | None = None,
        limited: bool = False,
    ) -> None:
        n, m, u = model.n, model.n_joint, model.n_torque
        self.model, self.moving, self.layout, self.actuation = model, moving, layout, actuation
        self.sensing, self.happening, self.limited = sensing, happening, limited
        self.gauges = curvature_columns(model.arm)
        held = any(model.arm.gravity) and not model.arm.base.n
        self.bent = bent_coordinates(model.arm) if held else []
        waves = WAVES * m * moving
        self.memory = {
            "action": u, "elapsed": 1, "target": m,
            "actuator": actuation.states if actuation else 0,
            **(sensing.memory if sensing else {"angles": 0}),
            "centre": m, "amplitude": waves, "frequency": waves, "phase": waves,
            "anchor": model.arm.base.n,
        }  # fmt: skip
        self.drawn = {k: size for x in (sensing, happening) if x for k, size in x.drawn.items()}
        free = len(model.free_parameters)
        self.state = Rows({"q": n, "v": n, **self.memory, "free": free, **self.drawn})
        given = {"angular_momentum": model.arm.base.n, "event": happening, "cost": limited}
        numbers = (*NUMBERS, *(name for name, present in given.items() if present))
        self.info = Rows({
            "reward": 1, **dict.fromkeys(numbers, 1), "reward_terms": len(TERMS),
            "root_curvature": len(self.gauges), "torque": u,
            **({"command": m} if actuation else {}),
            **({"linear_momentum": 2} if model.arm.base.n else {}),
        })  # fmt: skip
        self.constants = Rows({
            "torque_limit": u, "control_dt": 1, "max_steps": 1, "deflection_limit": 1,
            "slope_limit": 1, "rate_limit": 1, "per_rate": 1, "move_time": 1,
            "weights": len(TERMS), "factors": layout.size,
            **({"command_limit": m, "actuators": actuation.n_constant} if actuation else {}),
            **(sensing.constants if sensing else {}),
            **({"curvature_limit": len(self.gauges)} if limited else {}),
        })  # fmt: skip

    @property
    def addition(self) -> Addition:
        """Functions and entry point that the generated module has besides the accelerations."""
        m, u = self.model.n_joint, self.model.n_torque
        sizes = {name.upper(): size for name, size in self.memory.items()}
        sizes |= {"GIVEN": u, "BEFORE": u, "LOST": 1, "CONSTANTS": self.constants.total}
        sizes |= {"DRAWN": sum(self.drawn.values()), "NOISE": self.noise}
        # what `report` gives, in its order
        sizes |= {"TARGET_NOW": m, "READINGS_NOW": self.readings}
        sizes |= {"FLAGS": len(FLAGS), "INFO": self.info.total}
        sizes |= {"OBSERVATION": self.layout.size, "RATE_BEFORE": m if self.actuation else 0}
        sizes |= self.happening.slots(self.model) if self.happening else {}
        sizes |= {"REST": len(self.bent), "UNSETTLED": 1} if self.bent else {}
        parts = [(part.name, part.entries, part.bound) for part in self.layout.parts]

        def functions(at: Mapping[str, int]) -> list[Function]:
            inputs = [at[x] for x in ("Q", "V", "ACTION", "BEFORE", "LOST", "CONSTANTS")]
            inputs += [at["DRAWN"], at["NOISE"], at["PARAMETERS"]]
            state = [at[name] + k for name in ("Q", "V") for k in range(self.model.n)]
            rows = [self.info.slices[name].start for name in ("reward", *NUMBERS)]
            numbers = [at["INFO"] + row for row in rows]
            check = lost(state, numbers, at["LOST"], self.model.dtype)
            report = traced("report", self.graph, inputs, at["TARGET_NOW"])
            limit = at["CONSTANTS"] + self.constants.slices["torque_limit"].start
            return [command(self.model.n_torque, at, limit), check, report, *self._driving(at),
                    *self._placing(at), *self._bending(at), *self._happening(at)]  # fmt: skip

        keys = [x and x.key for x in (self.actuation, self.sensing, self.happening)]
        return Addition(
            key=f"environment {_SOURCES} {self.moving} {parts} {keys} {self.limited}",
            sizes=sizes,
            functions=functions,
            shared=("CONSTANTS",),
            entry=control_step(
                self.state,
                self.info.total,
                self.layout.size,
                self.noise,
                driven=self.actuation is not None,
                bent=len(self.bent),
                event=self.happening.name if self.happening else None,
            ),
        )

    @property
    def readings(self) -> int:
        """Number of kept readings."""
        return sum(self.sensing.memory.values()) if self.sensing else 0

    @property
    def noise(self) -> int:
        """Random numbers per step."""
        return self.sensing.noise if self.sensing else 0

    def _driving(self, at: Mapping[str, int]) -> list[Function]:
        """Functions of the actuators."""
        if self.actuation is None:
            return []
        return self.actuation.functions(
            at, at["CONSTANTS"] + self.constants.slices["actuators"].start
        )

    def _happening(self, at: Mapping[str, int]) -> list[Function]:
        """Functions of the event."""
        if self.happening is None:
            return []
        first = at["DRAWN"] + Rows(self.drawn).slices["event_time"].start
        return self.happening.functions(self.model, at, first)

    def _placing(self, at: Mapping[str, int]) -> list[Function]:
        """`place(w)` of an arm on a floating base: the base's pose with the tip on the target."""
        if not self.model.arm.base.n:
            return []
        inputs = [at[name] for name in ("Q", "CENTRE", "PARAMETERS")]
        return [traced("place", graphs.carried_base(self.model.traced), inputs, at["ANCHOR"])]

    def _bending(self, at: Mapping[str, int]) -> list[Function]:
        """`settle(w)`, a step to the equilibrium under gravity, and `bend(w)` of straight links.

        The actuators follow the roots of the bent links.
        Links too soft for an equilibrium that the model can follow start straight.
        """
        import casadi as ca

        if not self.bent:
            return []
        inputs = [at[name] for name in ("Q", "REST", "PARAMETERS")]
        settle = traced("settle", settling(self.model.traced), inputs, at["REST"])
        sizes = {"Q": self.model.n, "REST": len(self.bent), "UNSETTLED": 1, "ELAPSED": 1,
                 "ACTUATOR": self.memory["actuator"]}  # fmt: skip
        symbols = q, rest, unsettled, elapsed, actuator = [ca.SX.sym(*x) for x in sizes.items()]
        bow = ca.SX(self.model.n, 1)
        bow[self.bent] = (elapsed < 0.0) * (unsettled < SETTLED) * rest
        relaxed = actuator + self.actuation.rest(bow) if self.actuation else actuator
        outputs = ca.vertcat((q + bow)[self.bent], ca.fmax(elapsed, 0.0), relaxed)
        graph = ca.Function("bend", symbols, [outputs])
        inputs = [at[name] for name in sizes]
        states = (at["ACTUATOR"] + k for k in range(self.memory["actuator"]))
        slots = [*(at["Q"] + i for i in self.bent), at["ELAPSED"], *states]
        return [settle, traced("bend", graph, inputs, slots)]

    @property
    def graph(self) -> Any:
        """CasADi Function of the state and the constants: all that a step reports.

        (q, v, memory, before, lost, constants, drawn, noise, parameters) -> target, readings,
        flags, info, obs.
        """
        import casadi as ca

        model, total = self.model, sum(self.memory.values())
        sizes = {"q": model.n, "v": model.n, "memory": total, "before": model.n_torque, "lost": 1,
                 "constants": self.constants.total, "drawn": sum(self.drawn.values()),
                 "noise": self.noise,
                 "parameters": len(model.free_parameters) if model.arm.base.n else 0}  # fmt: skip
        symbols = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
        s = dict(symbols)
        s |= {k: symbols["memory"][rows] for k, rows in Rows(self.memory).slices.items()}
        s |= {k: symbols["constants"][rows] for k, rows in self.constants.slices.items()}
        s |= {k: symbols["drawn"][rows] for k, rows in Rows(self.drawn).slices.items()}
        s["time"] = s["control_dt"] * s["elapsed"]
        s["target"], s["target_rate"] = self._reference(s, s["time"])
        values = self._values(s)
        measured, kept = self._sensed(s, values)
        outputs = [s["target"], kept, *(values[name] for name in FLAGS)]
        outputs += [values[name] for name in self.info.sizes]
        outputs.append(self._observation(s, values, measured))
        return ca.Function("report", list(symbols.values()), [ca.cse(ca.vertcat(*outputs))])

    def _reference(self, s: Symbols, t: Any) -> tuple[Any, Any]:
        """Joint angles [rad] and rates [rad/s] of the target at time t.

        centre + ramp(t) sum_k A_k sin(w_k t + p_k): smooth to the second derivative, from rest.
        """
        import casadi as ca

        centre = self.happening.centre(s) if self.happening else s["centre"]
        if not self.moving:
            return centre, ca.SX(self.model.n_joint, 1)
        angle = s["frequency"] * t + s["phase"]
        shape = (self.model.n_joint, WAVES)
        value = ca.sum2(ca.reshape(s["amplitude"] * ca.sin(angle), *shape))
        rate = ca.sum2(ca.reshape(s["amplitude"] * s["frequency"] * ca.cos(angle), *shape))
        x = ca.fmin(t / s["move_time"], 1.0)
        ramp = x * x * x * (10.0 + x * (6.0 * x - 15.0))
        slope = 30.0 * x * x * (1.0 - x) * (1.0 - x) / s["move_time"]
        return centre + ramp * value, ramp * rate + slope * value

    def _measured(self, q: Any, v: Any) -> dict[str, Any]:
        values = graphs.measure(self.model.traced)(q, v)
        return {name: values[rows] for name, rows in self.model.measurements.items()}

    def _straight(self, joints: Any, base: Any = None) -> Any:
        """Coordinates of the straight-link arm; those of the base are zero if not given."""
        import casadi as ca

        x = ca.SX(self.model.n, 1)
        if base is not None:
            x[: base.numel()] = base
        for k, i in enumerate(self.model.arm.joint_index):
            x[i] = joints[k]
        return x

    def _values(self, s: Symbols) -> dict[str, Any]:
        """Flags (1 or 0) and info by name, and the tip error as a vector ("gap")."""
        import casadi as ca

        arm, here = self.model.arm, self._measured(s["q"], s["v"])
        on_target = self._straight(s["target"], s["anchor"])
        goal = self._measured(on_target, self._straight(s["target_rate"]))
        gap = goal["tip"] - here["tip"]
        error, speed = _length(gap), _length(goal["tip_velocity"] - here["tip_velocity"])
        bent = _length(here["tip"] - here["rigid_tip"])
        deflection = reduce(ca.fmax, ca.vertsplit(here["deflection"]))
        slope = reduce(ca.fmax, ca.vertsplit(here["slope"]))

        live, joint_rates = s["elapsed"] > 0.0, s["v"][list(arm.joint_index)]
        rates = joint_rates * s["per_rate"]
        ends = flags(s, live, error < SETTLED_BAND * arm.reach, deflection, slope, joint_rates)
        measured = Measured(
            error=error / arm.reach,
            speed=speed * s["per_rate"] / arm.reach,
            vibration=bent / (0.1 * arm.reach),
            rate=ca.sumsqr(rates) / arm.n_joint,
            effort=ca.sumsqr(s["action"]) / arm.n_torque,
            change=ca.sumsqr(s["action"] - s["before"]) / arm.n_torque,
            failed=ends["terminated"],
        )
        terms = ca.vertcat(*(term(measured) for term in TERMS.values()))
        return {
            **ends, "reward": live * ca.dot(s["weights"], terms), "time": s["time"],
            "tip_error": error, "tip_speed": speed, "deflection": deflection,
            "tip_deflection": bent,
            "reward_terms": terms, "root_curvature": here["curvature"][list(self.gauges)],
            **self._torques(s), **self._momentum(s), **self._marks(s, here["curvature"]),
            "gap": gap, "curvature": here["curvature"], "goal": goal["tip"],
            "tip": here["tip"], "tip_velocity": here["tip_velocity"],
        }  # fmt: skip

    def _torques(self, s: Symbols) -> dict[str, Any]:
        """Torques [N m] of the joints and a driven base, and the actuators' command, if any."""
        import casadi as ca

        ideal = s["action"] * s["torque_limit"]
        if self.actuation is None:
            return {"torque": ideal}
        m = self.model.n_joint
        torque = ca.vertcat(self.actuation.torque(s), ideal[m:])
        return {"torque": torque, "command": s["action"][:m] * s["command_limit"]}

    def _momentum(self, s: Symbols) -> dict[str, Any]:
        """Momentum of an arm on a floating base."""
        if not self.model.arm.base.n:
            return {}
        p = graphs.planar_momentum(self.model.traced, s["q"], s["v"], s["parameters"])
        return {"linear_momentum": p[:2], "angular_momentum": p[2]}

    def _marks(self, s: Symbols, curvature: Any) -> dict[str, Any]:
        """Marks in info: the event has happened, and the cost of curvature."""
        marks = {"event": self.happening.happened(s)} if self.happening else {}
        return marks | ({"cost": cost(s, curvature[list(self.gauges)])} if self.limited else {})

    def _sensed(self, s: Symbols, values: Symbols) -> tuple[Symbols, Any]:
        """Angles, rates, curvatures, acceleration as sensors give them, and readings to keep."""
        import casadi as ca

        turned = ca.sparsify(ca.DM(self.model.encoders))
        angle, rate = (ca.mtimes(turned, s[name]) for name in "qv")
        if "modal_amplitude" in self.layout.slices:  # beside it, the coordinates themselves
            joints = list(self.model.arm.joint_index)
            angle, rate = s["q"][joints], s["v"][joints]
        curvature = values["curvature"]
        if self.sensing:
            tip = {"velocity": values["tip_velocity"], "gravity": ca.DM(self.model.arm.gravity),
                   "axes": graphs.tip_axes(self.model.traced)(s["q"], s["v"])}  # fmt: skip
            return self.sensing.readings(s, angle, curvature, tip)
        return {"angle": angle, "rate": rate, "curvature": curvature}, ca.SX(0, 1)

    def _observation(self, s: Symbols, values: Symbols, measured: Symbols) -> Any:
        """Scaled and clipped observation."""
        import casadi as ca

        signals = self._signals(s, values, measured)
        picked = [signals[part.name][k] for part in self.layout.parts for k in part.entries]
        bounds = self.layout.bounds
        return ca.fmin(ca.fmax(ca.vertcat(*picked) * s["factors"], -bounds), bounds)

    def _signals(self, s: Symbols, values: Symbols, measured: Symbols) -> dict[str, Any]:
        """All signals that an observation may hold, in physical units."""
        import casadi as ca

        joints = measured["angle"]
        signals = {
            "joint_error": joints - s["target"],
            "joint_sin": ca.sin(joints),
            "joint_cos": ca.cos(joints),
            "joint_rate": measured["rate"],
            "modal_amplitude": s["q"],
            "modal_rate": s["v"],
            "tip_error": self._in_first_link(self._in_base(s, values["gap"]), joints[0]),
            "root_curvature": measured["curvature"],
            "tip_acceleration": measured.get("acceleration"),
            "last_action": s["action"],
            "achieved_goal": values["tip"],
            "desired_goal": values["goal"],
            "joint_torque": values["torque"],
            "target_rate": s["target_rate"],
        }
        if self.model.arm.base.n:
            start = ca.DM(self.model.arm.base.position[:2])
            signals["base_position"], signals["base_velocity"] = s["q"][:2] - start, s["v"][:2]
            signals["base_sin"], signals["base_cos"] = ca.sin(s["q"][2]), ca.cos(s["q"][2])
            signals["base_rate"] = s["v"][2]
            seen = values["goal"] - ca.vertcat(s["q"][:2], 0.0)
            signals["target_position"] = self._in_base(s, seen)
        for name, share in (("target_near", 0.5), ("target_far", 1.0)):
            ahead, _ = self._reference(s, s["time"] + share * s["move_time"])
            signals[name] = ahead - s["target"]
        return signals

    def _in_base(self, s: Symbols, vector: Any) -> Any:
        """Components of a world vector along the axes of the base."""
        import casadi as ca

        if not self.model.arm.base.n:
            return vector
        (x, y, z), c, d = ca.vertsplit(vector), ca.cos(s["q"][2]), ca.sin(s["q"][2])
        return ca.vertcat(c * x + d * y, c * y - d * x, z)

    def _in_first_link(self, vector: Any, angle: Any) -> Any:
        """Components of a vector in the base along the axes of the first joint's link, straight."""
        import casadi as ca

        arm = self.model.arm
        turns = [ca.DM(x.joint.rotation) for x in arm.links[: arm.joints[0] + 1]]
        x, y, z = ca.vertsplit(ca.mtimes(reduce(ca.mtimes, turns).T, vector))
        c, d = ca.cos(angle), ca.sin(angle)
        return ca.vertcat(c * x + d * y, c * y - d * x, z)


def _length(vector: Any) -> Any:
    import casadi as ca

    return ca.sqrt(ca.sumsqr(vector))
