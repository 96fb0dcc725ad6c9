"""The compiled arm: dynamics quantities at a state, and programs that step it."""

import warnings
from collections.abc import Sequence
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np

from dynamics.backends.numba_llvm.program import inverse_dynamics, program
from dynamics.backends.numba_llvm.stepper_entries import LANES, LANES_OF
from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.description.deflection import curvature
from dynamics.description.rotations import from_rotation_vector, rotation_matrix
from dynamics.formulations import free_base, gibbs_appell, linearized
from dynamics.formulations.christoffel import christoffel
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.formulations.link_constants import parts
from dynamics.load import ArmSource, load_arm
from dynamics.runtime.jit import aligned_zeros
from dynamics.tracing import graphs
from dynamics.tracing.assembly import Addition
from dynamics.tracing.equilibrium import Equilibrium, equilibrium
from dynamics.tracing.operation_counts import operations
from dynamics.tracing.traced_arm import TracedArm
from dynamics.types import Array
from dynamics.validity import ValidityWarning, bending

_REACHED = 1.0 + 1e-12  # [-] a step that round-off puts behind a place on a link is reached


def compile_arm(
    arm: ArmSource,
    *,
    formulation: str = "gibbs_appell",
    dtype: str = "float64",
    free_parameters: Sequence[str] = (),
) -> "Model":
    """Compile an arm.

    Parameters
    ----------
    arm : an Arm, a preset's name, a path or a dict, as `load_arm` accepts.
    formulation : formulation of the equations of motion, a name in FORMULATIONS; stepping is
        fastest with "gibbs_appell".
    dtype : number type of the compiled stepping code, "float64" or "float32"; descriptions,
        states and results stay float64.
    free_parameters : names in FREE_PARAMETERS that stay inputs instead of compiled constants.

    Raises
    ------
    ValueError : with the argument, its value and the possible values.
    """
    validate.known(dtype, "dtype", LANES_OF)
    names = validate.sequence(free_parameters, "free_parameters")
    free = [validate.known(name, "free parameter", FREE_PARAMETERS) for name in names]
    model = Model(load_arm(arm), tuple(dict.fromkeys(free)), dtype, formulation)
    if "payload_mass" in free and not model.arm.links:
        raise ValueError("payload_mass needs a link to be fixed to, but this arm has none.")
    for parameter in map(FREE_PARAMETERS.__getitem__, free):
        parameter.apply(model.chain, parameter.nominal)  # refuses one that the arm does not have
    return model


class Model:
    """One compiled arm; immutable, so that environments and threads can share it.

    The equations of motion are M qdd + h = B tau. Arguments `q`, `v` are (n,) arrays. Coordinates
    run link by link: q_i [rad], then the link's modal amplitudes [m]. The six coordinates of a
    free base come first: position [m] and rotation vector [rad] from the world. Their rates are
    the velocity in the world and the angular velocity in the base's own frame; their forces are
    a force in the world and a moment in the base's own frame. Of a planar base these are three:
    position [m] and angle [rad], with their derivatives as rates.
    """

    def __init__(
        self,
        arm: Arm,
        free_parameters: tuple[str, ...] = (),
        dtype: str = "float64",
        formulation: str = "gibbs_appell",
    ) -> None:
        self.arm, self.dtype, self.formulation = arm, dtype, formulation
        self.free_parameters = free_parameters
        self.traced = TracedArm(arm, free_parameters, formulation)
        self.equations = self.traced.formed.equations
        self.chain, self.bodies = self.traced.chain, self.traced.bodies
        self.lanes = LANES_OF[dtype]  # environments that a batch steps side by side
        self.names = list(arm.names)
        self.n, self.n_joint, self.n_torque = arm.n, arm.n_joint, arm.n_torque
        self.measurements = self.traced.measurements
        self.n_measure = self.traced.n_measure
        self._programs: dict[tuple[int, str, str, bool], ModuleType] = {}

    def __reduce__(self) -> Any:
        return Model, (self.arm, self.free_parameters, self.dtype, self.formulation)

    # ---- quantities at a state -----------------------------------------------------------------

    def mass_matrix(self, q: Array) -> Array:
        """Mass matrix M (n, n) at q."""
        return self._at_state("mass_matrix", q, np.zeros(self.n))

    def bias(self, q: Array, v: Array) -> Array:
        """Bias h (n,): velocity-dependent inertial, gravity, elastic and dissipative forces."""
        return self._at_state("bias", q, v).ravel()

    def christoffel(self, q: Array, v: Array) -> Array:
        """Matrix H (n, n): H v are the velocity terms of h, and dM/dt - 2 H is skew-symmetric.

        With rotation "linear" H v are these only in the formulation "book", whose energy is kept.
        """
        self._require_fixed_base("christoffel")
        H = np.array(self._christoffel(self._q(q), self._q(v, "v")))
        return validate.finite(H, "christoffel")

    def accelerations(self, q: Array, v: Array, tau: Array) -> Array:
        """Accelerations (n,) under torques tau (n_torque,) [N m]: joints, then a driven base."""
        program = self.program(1, "rk4")
        out = np.empty((1, self.n))
        program.evaluate_states(
            self._q(q)[None], self._q(v, "v")[None], self._tau(tau)[None],
            self.nominal_parameters[None], self.workspace(program), out,
        )  # fmt: skip
        return validate.finite(out[0], "accelerations")

    def inverse_dynamics(self, q: Array, v: Array, a: Array, wrench: Array | None = None) -> Array:
        """Generalized forces M a + h (n,); joint torques alone can only produce B tau.

        Of a fixed base, (N, n) at N states given as (N, n), without a wrench.
        `wrench` (6,), force [N] then moment [N m], is exerted by the last link at its tip on its
        surroundings, in the link's frame; of a link in segments, in that of the last.
        """
        if np.ndim(q) == 2 and wrench is None:
            return self._forces(q, v, a)
        h = self.bias(q, v)
        if wrench is not None:
            self._require_fixed_base("wrench")
            x, rates = self._q(q).tolist(), self._q(v, "v").tolist()
            f = validate.array(wrench, "wrench", (6,)).tolist()
            load = gibbs_appell.Wrench(f[:3], f[3:])
            loaded, free = (
                np.array(gibbs_appell.bias(self.chain, x, rates, tip), dtype=np.float64)
                for tip in (load, gibbs_appell.NO_LOAD)
            )
            h = h + (loaded - free)
        return self.mass_matrix(q) @ self._q(a, "a") + h

    def energy(self, q: Array, v: Array) -> tuple[float, float, float]:
        """Kinetic, elastic and gravity energy [J].

        The gravity energy is zero with all mass at the world's origin.
        """
        kinetic, elastic, gravity = self._at_state("energy", q, v).ravel().tolist()
        return kinetic, elastic, gravity

    def momentum(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Linear (3,) [N s] and angular (3,) [N m s] momentum about the world's origin."""
        values = self._at_state("momentum", q, v).ravel()
        return values[:3], values[3:]

    def tip(self, q: Array) -> Array:
        """Tip position (3,) [m] of the last link in the world."""
        return self._measure(q, np.zeros(self.n))[self.measurements["tip"]]

    def tip_velocity(self, q: Array, v: Array) -> Array:
        """Tip velocity (3,) [m/s] of the last link in the world."""
        return self._measure(q, v)[self.measurements["tip_velocity"]]

    def strain(self, q: Array, link: int, x: float) -> Array:
        """Twist rate and bending curvatures about y and z (3,) [1/m] of a link at x [m].

        On a step between two sections, or a weld of segments, they are those of the outer side.
        A strain gauge reads the curvature times the gauge's distance from the neutral axis.
        """
        described = self.arm.links[validate.integer(link, "link", 0, len(self.arm.links) - 1)]
        if not 0.0 <= validate.number(x, "x", "m") <= described.length:
            raise ValueError(f"x must be within the link, 0 to {described.length} m, got {x!r}.")
        x = min(x * _REACHED, described.length)
        size = described.length / described.segments
        k = min(int(x / size), described.segments - 1)
        _, delta = self.chain.split(self._q(q).tolist())[self.bodies[link].start + k]
        with np.errstate(over="ignore", invalid="ignore"):
            found = np.asarray(delta) @ curvature(parts(described)[k], x - k * size)
        return validate.finite(found, "strain")

    def frequencies(self, q: Array | None = None, joints: str = "locked") -> Array:
        """Natural frequencies [rad/s] of the undeflected arm at the joint angles of q, no gravity.

        joints="locked" locks the coordinates q_i; "free" leaves them free and omits the rigid-body
        modes. A free base moves freely in both.
        """
        validate.choice(joints, "joints", ("locked", "free"))
        rigid = self.rigid(np.zeros(self.n) if q is None else self._q(q))
        return linearized.frequencies(
            np.array(self.equations.mass_matrix(self.chain, [float(x) for x in rigid])),
            self.stiffness,
            self.n - self.n_joint - self.arm.base.n,
            locked=self.arm.joint_index if joints == "locked" else (),
        )

    def equilibrium(self, joint_angles: Array) -> Equilibrium:
        """Rest under gravity: q (n,) with bent links, and the torques (n_joint,) that hold it.

        Raises ValueError for a base that moves, and where gravity bends links beyond the model; a
        ValidityWarning says where it bends them beyond small deflections.
        """
        if self.arm.base.n:
            raise ValueError(
                f"equilibrium needs a fixed base, got Base.type {self.arm.base.type!r}: nothing "
                "holds one that moves."
            )
        angles = validate.array(joint_angles, "joint_angles", (self.n_joint,))
        with validate.double_precision("The arm's equilibrium"):
            found = equilibrium(self.traced, angles)
        for sentence in bending(self.arm, self.chain, self.bodies, found.q[None]):
            warnings.warn(sentence, ValidityWarning, stacklevel=2)
        return found

    def linearize(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """A (2n, 2n) and B (2n, n_torque) of d/dt (q, v) = A (q, v) + B tau about a state.

        The rotation of a free base is here the small rotation from the state's attitude, in the
        base's own frame.
        """
        state = self._state(q, v)
        dq, dv, dtau = (np.array(d) for d in self._jacobian(*state, self._tau(tau)))
        n, kinematic = self.n, np.zeros((self.n, self.n))
        if self.arm.base.spatial:
            kinematic[3:6, 3:6] = np.cross(np.eye(3), state[1][3:6]).T  # -omega~
            turn = np.eye(n)
            turn[:3, :3] = rotation_matrix(state[2])
            dq, dv, dtau = turn @ dq @ turn.T, turn @ dv @ turn.T, turn @ dtau
        A = np.block([[kinematic, np.eye(n)], [dq, dv]])
        B = np.vstack([np.zeros((n, self.n_torque)), dtau])
        return validate.finite(A, "linearize"), validate.finite(B, "linearize")

    def operation_count(self) -> dict[str, dict[str, int]]:
        """Operations of each kind in the expression graphs of the arm."""
        counted = {
            "accelerations": self.graph,
            "mass matrix and bias": graphs.mass_matrix_and_bias(self.traced),
        }
        return {name: operations(graph) for name, graph in counted.items()}

    @property
    def graph(self) -> Any:
        """CasADi Function (q, v, tau, parameters, []) -> accelerations, see tracing/graphs.py."""
        return graphs.accelerations(self.traced)

    @property
    def nominal_parameters(self) -> Array:
        """(n_parameter,) values of the free parameters that reproduce the described arm."""
        return self.traced.nominal_parameters.copy()

    @cached_property
    def encoders(self) -> Array:
        """(n_joint, n) joint angles that ideal encoders read, by q; read-only.

        Encoders turn with the roots of the links, which pinned-free modes turn too.
        """
        return _read_only(linearized.inputs(self.chain)[:, : self.n_joint].T)

    @cached_property
    def stiffness(self) -> Array:
        """Stiffness matrix K (n, n), zero in the joints; read-only."""
        return _read_only(linearized.stiffness(self.chain))

    def rigid(self, q: Array) -> Array:
        """Copy of q, (n,) or (N, n), with straight links and a free base at the origin."""
        straight = np.zeros_like(q)
        straight[..., list(self.arm.joint_index)] = q[..., list(self.arm.joint_index)]
        return straight

    # ---- compiled programs ---------------------------------------------------------------------

    def program(
        self,
        lanes: int,
        integrator: str,
        addition: Addition | None = None,
        derivatives: bool = False,
    ) -> ModuleType:
        """Generated module for a number of lanes and an integrator, from the cache if possible.

        `addition` replaces the measurements and entry points of the stepper; with `derivatives`,
        those of its control step, or its motion with derivatives, take the place of that.
        """
        kind = lanes, integrator, addition.key if addition else "", derivatives
        if kind not in self._programs:
            self._programs[kind] = program(
                self.traced, self.dtype, lanes, integrator, addition, derivatives
            )
        return self._programs[kind]

    def workspace(self, program: ModuleType) -> Array:
        """Workspace of `program` for one thread."""
        return aligned_zeros(program.SLOTS * int(program.LANES), self.dtype)

    # ---- expression graphs ---------------------------------------------------------------------

    @cached_property
    def _forces_program(self) -> ModuleType:
        return program(self.traced, "float64", LANES, "rk4", inverse_dynamics(self.traced))

    @cached_property
    def _state_functions(self) -> dict[str, Any]:
        return graphs.state_functions(self.traced)

    @cached_property
    def _jacobian(self) -> Any:
        return graphs.jacobians(self.traced)

    @cached_property
    def _christoffel(self) -> Any:
        return christoffel(self.equations, self.chain, self.n)

    def _at_state(self, quantity: str, q: Array, v: Array) -> Array:
        function = self._state_functions[quantity]
        return validate.finite(np.array(function(*self._state(q, v))), quantity)

    def _forces(self, q: Array, v: Array, a: Array) -> Array:
        """(N, n) M a + h at N states."""
        self._require_fixed_base("inverse_dynamics of many states")
        shape = (np.shape(q)[0], self.n)
        given = (validate.array(*x, shape) for x in ((q, "q"), (v, "v"), (a, "a")))
        q, v, a = map(np.ascontiguousarray, given)
        module, forces = self._forces_program, np.empty(shape)
        workspace = aligned_zeros(module.SLOTS * LANES, "float64")
        module.forces_of_states(q, v, a, workspace, forces)
        return validate.finite(forces, "inverse_dynamics")

    def _measure(self, q: Array, v: Array) -> Array:
        return validate.finite(
            np.array(graphs.measure(self.traced)(*self._state(q, v))).ravel(), "measurements"
        )

    def _state(self, q: Array, v: Array) -> tuple[Array, ...]:
        """q and v; with a free base, both in the base's own frame, and the attitude (4,)."""
        q, v = self._q(q), self._q(v, "v")
        if not self.arm.base.spatial:
            return q, v
        attitude = from_rotation_vector(q[3:6].tolist())
        own = free_base.unturned(free_base.local(q.tolist(), attitude), attitude)
        rates = free_base.local(v.tolist(), attitude)
        return np.array(own), np.array(rates), np.array(attitude)

    def _require_fixed_base(self, name: str) -> None:
        if self.arm.base.spatial:
            raise ValueError(
                f"{name} needs an arm with a fixed or planar base, got Base.type "
                f"{self.arm.base.type!r}."
            )

    def _q(self, x: Array, name: str = "q") -> Array:
        return validate.array(x, name, (self.n,))

    def _tau(self, x: Array) -> Array:
        return validate.array(x, "tau", (self.n_torque,))


def _read_only(values: Array) -> Array:
    values.flags.writeable = False
    return values
