"""The compiled arm and its questions."""

import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np

from dynamics import checks, free_base, gibbs_appell, graphs, linear
from dynamics.arm import Arm
from dynamics.arm_file import ArmSource, load_arm
from dynamics.attitude import from_rotation_vector, rotation_matrix
from dynamics.christoffel import christoffel
from dynamics.formulations import formulation_for
from dynamics.free_parameters import FREE_PARAMETERS
from dynamics.integrators import INTEGRATORS
from dynamics.kernels import ENTRIES, FLIGHT, LANES, STEPS, aligned_zeros
from dynamics.kinematics import Chain
from dynamics.lowering import (
    Addition,
    cached_module,
    expanded,
    fingerprint,
    operations,
    render_check,
    render_function,
    render_module,
)
from dynamics.modes import chain_constants, curvature, parts
from dynamics.stepping import jacobian_code, method_code

Array = np.ndarray

LANES_OF = {"float64": LANES, "float32": 2 * LANES}


def compile_arm(
    arm: ArmSource,
    *,
    formulation: str = "gibbs_appell",
    dtype: str = "float64",
    free_parameters: Sequence[str] = (),
) -> "Model":
    """Compile an arm, or whatever `load_arm` accepts.

    Parameters
    ----------
    arm : an Arm, a preset's name, a path or a dict.
    formulation : how the equations of motion are formed, a name in FORMULATIONS; stepping is
        fastest with "gibbs_appell".
    dtype : number type of the compiled stepping code, "float64" or "float32"; descriptions,
        states and answers are float64 all the same.
    free_parameters : names in FREE_PARAMETERS that stay inputs instead of folding away.

    Raises
    ------
    ValueError : naming the argument, its value and what is possible.
    """
    checks.known(dtype, "dtype", LANES_OF)
    names = checks.sequence(free_parameters, "free_parameters")
    free = [checks.known(name, "free parameter", FREE_PARAMETERS) for name in names]
    return Model(load_arm(arm), tuple(dict.fromkeys(free)), dtype, formulation)


class Model:
    """One arm, compiled; immutable, so one model serves every environment and thread.

    Coordinates run link by link, q_i [rad] then the link's modal amplitudes [m];
    M qdd + h = B tau. Arguments `q`, `v` are (n,) arrays. A free base's six come first: position
    [m] and rotation vector [rad] from the world; their rates are the velocity in the world and
    the angular velocity in the base's own frame, their forces a force in the world and a moment
    in that frame.
    """

    def __init__(
        self,
        arm: Arm,
        free_parameters: tuple[str, ...] = (),
        dtype: str = "float64",
        formulation: str = "gibbs_appell",
    ) -> None:
        self.arm, self.dtype, self.formulation = arm, dtype, formulation
        self.formed = formulation_for(arm, formulation)
        self.lanes = LANES_OF[dtype]  # environments that a batch steps side by side
        self.free_parameters = free_parameters
        self.names = list(arm.names)
        self.n, self.n_joint = arm.n, arm.n_joint
        bodies = chain_constants(arm)
        base = free_base.bodies(arm.base)
        stops = np.cumsum([len(base), *(len(link) for link in bodies)]).tolist()
        self.bodies = tuple(
            slice(b - link.segments, b) for link, b in zip(arm.links, stops[1:], strict=True)
        )  # parts of every link in the chain
        links = (*base, *(body for link in bodies for body in link))
        rotation = "exp" if arm.rotation == "exp" else "linear"
        self.chain = Chain(links, arm.gravity, rotation, bool(base))
        # of a free base, gravity is an input: its own frame turns
        self.n_gravity = 3 if base and any(arm.gravity) else 0
        self.nominal_parameters = np.array([FREE_PARAMETERS[p].nominal for p in free_parameters])
        widths = {
            "tip": 3, "tip_velocity": 3, "rigid_tip": 3, "deflection": self.n_joint,
            "slope": self.n_joint, "curvature": 2 * self.n_joint,
        }  # fmt: skip
        stops = np.cumsum(list(widths.values())).tolist()
        self.measurements = {
            name: slice(stop - width, stop)
            for (name, width), stop in zip(widths.items(), stops, strict=True)
        }
        self.n_measure = stops[-1]
        self._programs: dict[tuple[int, str, str], ModuleType] = {}

    def __reduce__(self) -> Any:
        return Model, (self.arm, self.free_parameters, self.dtype, self.formulation)

    # ---- questions -----------------------------------------------------------------------------

    def mass_matrix(self, q: Array) -> Array:
        """(n, n) M at q."""
        return self._answer("mass_matrix", q, np.zeros(self.n))

    def bias(self, q: Array, v: Array) -> Array:
        """(n,) h: inertial, gravity, elastic and dissipative forces."""
        return self._answer("bias", q, v).ravel()

    def christoffel(self, q: Array, v: Array) -> Array:
        """(n, n) H: H v are the velocity terms of h, dM/dt - 2 H is skew-symmetric."""
        self._refuse_flight("christoffel")
        return np.array(self._christoffel(self._q(q), self._q(v, "v")))

    def accelerations(self, q: Array, v: Array, tau: Array) -> Array:
        """(n,) second derivatives under joint torques tau (n_joint,) [N m]."""
        program = self.program(1, "rk4")
        out = np.empty((1, self.n))
        program.evaluate_states(
            self._q(q)[None], self._q(v, "v")[None], self._tau(tau)[None],
            self.nominal_parameters[None], self.workspace(program), out,
        )  # fmt: skip
        return checks.finite(out[0], "accelerations")

    def inverse_dynamics(self, q: Array, v: Array, a: Array, wrench: Array | None = None) -> Array:
        """(n,) generalized forces M a + h; motion under joint torques alone needs B tau.

        `wrench` (6,), force [N] then moment [N m], is what the last link exerts at its tip on its
        surroundings, in that link's frame.
        """
        h = self.bias(q, v)
        if wrench is not None:
            self._refuse_flight("wrench")
            x, rates = self._q(q).tolist(), self._q(v, "v").tolist()
            f = checks.array(wrench, "wrench", (6,)).tolist()
            load = gibbs_appell.Wrench(f[:3], f[3:])
            h = np.array(gibbs_appell.bias(self.chain, x, rates, load), dtype=np.float64)
        return self.mass_matrix(q) @ self._q(a, "a") + h

    def energy(self, q: Array, v: Array) -> tuple[float, float, float]:
        """(kinetic, elastic, gravity) [J]; gravity is zero with all mass at the world's origin."""
        kinetic, elastic, gravity = self._answer("energy", q, v).ravel().tolist()
        return kinetic, elastic, gravity

    def momentum(self, q: Array, v: Array) -> tuple[Array, Array]:
        """(3,) [N s] linear and (3,) [N m s] angular momentum about the world's origin."""
        values = self._answer("momentum", q, v).ravel()
        return values[:3], values[3:]

    def tip(self, q: Array) -> Array:
        """(3,) [m] tip of the last link in the world."""
        return self._measure(q, np.zeros(self.n))[self.measurements["tip"]]

    def tip_velocity(self, q: Array, v: Array) -> Array:
        """(3,) [m/s] velocity of that tip."""
        return self._measure(q, v)[self.measurements["tip_velocity"]]

    def strain(self, q: Array, link: int, x: float) -> Array:
        """(3,) [1/m] twist rate and bending curvatures about y and z of a link at x.

        The strain a gauge reads is curvature times its distance from the neutral axis.
        """
        described = self.arm.links[checks.integer(link, "link", 0, self.n_joint - 1)]
        if not 0.0 <= checks.number(x, "x", "m") <= described.length:
            raise ValueError(f"x must be within the link, 0 to {described.length} m, got {x!r}.")
        segment = parts(described)[0]
        k = min(int(x / segment.length), described.segments - 1)
        _, delta = self.chain.split(self._q(q).tolist())[self.bodies[link].start + k]
        return np.asarray(delta) @ curvature(segment, x - k * segment.length)

    def frequencies(self, q: Array | None = None, joints: str = "locked") -> Array:
        """[rad/s] natural frequencies at the joint angles of q, undeflected, elastic forces only.

        joints="locked" holds the coordinates q_i; "free" leaves them free and omits the rigid
        motions. A free base flies in both.
        """
        checks.choice(joints, "joints", ("locked", "free"))
        rigid = self.rigid(np.zeros(self.n) if q is None else self._q(q))
        M: Array = np.array(
            self.formed.equations.mass_matrix(self.chain, [float(x) for x in rigid])
        )
        K = self.stiffness
        if joints == "locked":
            moving = np.setdiff1d(np.arange(self.n), self.arm.joint_index)
            M, K = M[np.ix_(moving, moving)], K[np.ix_(moving, moving)]
        from scipy.linalg import eigh

        with checks.double_precision("The arm's frequencies"):
            squares = eigh(K, M, eigvals_only=True)
        elastic = self.n - self.n_joint - self.arm.base.n
        return np.sqrt(np.abs(squares[squares.size - elastic :]))

    def linearize(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """A (2n, 2n) and B (2n, n_joint) of d/dt (q, v) = A (q, v) + B tau about a state.

        A free base's rotation is here a small one from the attitude of that state, seen in the
        base's own frame.
        """
        state = self._state(q, v)
        dq, dv, dtau = (np.array(d) for d in self._jacobian(*state, self._tau(tau)))
        n, kinematic = self.n, np.zeros((self.n, self.n))
        if self.arm.base.n:
            kinematic[3:6, 3:6] = np.cross(np.eye(3), state[1][3:6]).T  # -omega~
            turn = np.eye(n)
            turn[:3, :3] = rotation_matrix(state[2])
            dq, dv, dtau = turn @ dq @ turn.T, turn @ dv @ turn.T, turn @ dtau
        A = np.block([[kinematic, np.eye(n)], [dq, dv]])
        return A, np.vstack([np.zeros((n, self.n_joint)), dtau])

    def operation_count(self) -> dict[str, dict[str, int]]:
        """Operations of the traced arm, by running through its graphs."""
        counted = {
            "accelerations": self.graph,
            "mass matrix and bias": graphs.mass_matrix_and_bias(self),
        }
        return {name: operations(graph) for name, graph in counted.items()}

    @cached_property
    def graph(self) -> Any:
        """CasADi Function (q, v, tau, parameters, nothing) -> accelerations.

        Of a free base in coordinates whose rates are derivatives: x and rotation vector in a frame
        that does not move, in which gravity ends the parameters: see free_base.py.
        """
        return self._accelerations(implicit=False)

    def _accelerations(self, implicit: bool) -> Any:
        with checks.double_precision("The arm's accelerations"):
            return graphs.accelerations(self, implicit)

    @cached_property
    def stiffness(self) -> Array:
        """(n, n) K, zero in the joints."""
        return linear.stiffness(self.chain)

    def rigid(self, q: Array) -> Array:
        """A copy of q, (n,) or (N, n), with every link straight, a free base at the origin."""
        straight = np.zeros_like(q)
        straight[..., list(self.arm.joint_index)] = q[..., list(self.arm.joint_index)]
        return straight

    # ---- compiled programs ---------------------------------------------------------------------

    def program(self, lanes: int, integrator: str, addition: Addition | None = None) -> ModuleType:
        """The generated module for a number of lanes and a method; from the cache where it can.

        `addition` replaces the stepper's measurements and entry points by others.
        """
        kind = lanes, integrator, addition.key if addition else ""
        if kind not in self._programs:
            self._programs[kind] = self._program(lanes, integrator, addition or self._stepping)
        return self._programs[kind]

    def _program(self, lanes: int, integrator: str, added: Addition) -> ModuleType:
        arm, free = json.dumps(self.arm.to_dict(), sort_keys=True), ",".join(self.free_parameters)
        key = fingerprint(
            arm, free, str(lanes), integrator, self.dtype, self.formulation, added.key
        )
        return cached_module(key, lambda: self._generate(lanes, integrator, added))

    def workspace(self, program: ModuleType) -> Array:
        """Scratch memory for one thread in `program`."""
        return aligned_zeros(program.SLOTS * int(program.LANES), self.dtype)

    def _generate(self, lanes: int, integrator: str, added: Addition) -> str:
        method = INTEGRATORS[integrator]
        if self.arm.base.n and method.kept(self.n):
            others = [name for name, other in INTEGRATORS.items() if not other.kept(self.n)]
            raise ValueError(
                f"integrator {integrator!r} remembers earlier steps, but a free base has new "
                f"coordinates after every step; take one of {others}."
            )
        parameters = len(self.free_parameters) + self.n_gravity
        sizes = {
            **({"ATTITUDE": 4} if self.arm.base.n else {}),
            "Q": self.n, "V": self.n, "TAU": self.n_joint, "PARAMETERS": parameters,
            "IMPLICIT": 2 + self.n, "ACC": self.n, "H": 1, "SCRATCH": method.scratch(self.n),
            **added.sizes,
        }  # fmt: skip
        starts = np.cumsum([0, *sizes.values()]).tolist()
        at, implicit = dict(zip(sizes, starts, strict=False)), method.implicit
        inputs = [at["Q"], at["V"], at["TAU"], at["PARAMETERS"], at["IMPLICIT"]]
        graphs.check_rest(self)
        graph = self._accelerations(implicit) if implicit else self.graph
        modes = linear.frozen_modes(self.chain) if method.aid == "modes" else None
        stepping, calls = method_code(integrator, self.n, at, modes)
        flight = FLIGHT if self.arm.base.n else dict.fromkeys(FLIGHT, ())
        marks = {"#evaluate": ["accelerations(w)"], **STEPS, **calls, **flight, **added.marks}
        further = added.functions(at)
        functions = [
            render_function("accelerations", graph, inputs, at["ACC"]),
            *further,
            *([jacobian_code(self, inputs, at["SCRATCH"])] if method.aid == "jacobian" else []),
            *self._renewal(at),
            *(expanded(text, marks) for text in stepping),
        ]
        title = f"{self.arm.name or 'arm'}, {lanes} lanes, {integrator}, {self.dtype}"
        constants = at | {"N": self.n}
        work = functions[0].count(" = "), "".join(further).count(" = ")
        entries = expanded(added.entries, marks)
        return render_module(title, lanes, starts[-1], work, constants, functions, entries)

    @property
    def _stepping(self) -> Addition:
        """What the stepper needs: measurements, and a check for numbers that are not finite."""

        def functions(at: Mapping[str, int]) -> list[str]:
            inputs = [at[name] for name in ("Q", "V", "ATTITUDE") if name in at]
            measure = render_function("measure", self.measure_graph, inputs, at["MEASURED"])
            state = range(at.get("ATTITUDE", at["Q"]), at["V"] + self.n)
            return [measure, render_check(state, at["CHECK"], at["GOOD"])]

        sizes = {"CHECK": 1, "GOOD": 1, "MEASURED": self.n_measure}
        return Addition(key="stepper", sizes=sizes, functions=functions, entries=ENTRIES)

    def _renewal(self, at: Mapping[str, int]) -> list[str]:
        """Source of what follows every step with a free base."""
        if not self.arm.base.n:
            return []
        places = {**at, "GRAVITY": at["PARAMETERS"] + len(self.free_parameters)}
        graph, sizes = graphs.renewal(self.arm.gravity)
        inputs = [places[name] for name in list(sizes)[:3]]
        outputs = [places[name] + i for name, size in sizes.items() for i in range(size)]
        chart = "from dynamics.chart import enter, leave, turn"
        return [chart, render_function("renew", graph, inputs, outputs)]

    # ---- tracing -------------------------------------------------------------------------------

    @cached_property
    def jacobian_graph(self) -> Any:
        """CasADi Function (q, v, tau, parameters, nothing) -> da/dq, then da/dv, row by row."""
        return graphs.state_jacobian(self.graph)

    @cached_property
    def measure_graph(self) -> Any:
        """CasADi Function (q, v) -> what `measurements` names: see graphs.measure."""
        return graphs.measure(self)

    @cached_property
    def _questions(self) -> dict[str, Any]:
        return graphs.questions(self)

    @cached_property
    def _jacobian(self) -> Any:
        return graphs.jacobians(self)

    @cached_property
    def _christoffel(self) -> Any:
        return christoffel(self.formed.equations, self.chain, self.n)

    def _answer(self, question: str, q: Array, v: Array) -> Array:
        return checks.finite(np.array(self._questions[question](*self._state(q, v))), question)

    def _measure(self, q: Array, v: Array) -> Array:
        return checks.finite(
            np.array(self.measure_graph(*self._state(q, v))).ravel(), "measurements"
        )

    def _state(self, q: Array, v: Array) -> tuple[Array, ...]:
        """q and v; of a free base, in its own frame, and its attitude (4,)."""
        q, v = self._q(q), self._q(v, "v")
        if not self.arm.base.n:
            return q, v
        attitude = from_rotation_vector(q[3:6].tolist())
        own = free_base.unturned(free_base.local(q.tolist(), attitude), attitude)
        rates = free_base.local(v.tolist(), attitude)
        return np.array(own), np.array(rates), np.array(attitude)

    def _refuse_flight(self, what: str) -> None:
        if self.arm.base.n:
            raise ValueError(f"{what} is for an arm with a fixed base; this one flies.")

    def _q(self, x: Array, name: str = "q") -> Array:
        return checks.array(x, name, (self.n,))

    def _tau(self, x: Array) -> Array:
        return checks.array(x, "tau", (self.n_joint,))
