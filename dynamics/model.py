"""The compiled arm and its questions."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np

from dynamics import linear
from dynamics.algebra import add, combine, matvec
from dynamics.arm import Arm
from dynamics.arm_file import load_arm
from dynamics.christoffel import christoffel
from dynamics.elimination import Implicit
from dynamics.formulations import formulation_for
from dynamics.free_parameters import FREE_PARAMETERS
from dynamics.integrators import INTEGRATORS
from dynamics.kernels import GLUE, LANES
from dynamics.kinematics import Chain, outward, poses
from dynamics.lowering import (
    Addition,
    cached_module,
    fingerprint,
    operations,
    render_function,
    render_module,
)
from dynamics.modes import chain_constants, curvature, parts

Array = np.ndarray

LANES_OF = {"float64": LANES, "float32": 2 * LANES}


def compile_arm(
    arm: Arm | str | dict[str, Any],
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
    if dtype not in LANES_OF:
        raise ValueError(f"Unknown dtype {dtype!r}. Known: {sorted(LANES_OF)}.")
    unknown = sorted(set(free_parameters) - set(FREE_PARAMETERS))
    if unknown:
        raise ValueError(f"Unknown free parameters {unknown}. Known: {sorted(FREE_PARAMETERS)}.")
    return Model(load_arm(arm), tuple(free_parameters), dtype, formulation)


class Model:
    """One arm, compiled; immutable, so one model serves every environment and thread.

    Coordinates run link by link, q_i [rad] then the link's modal amplitudes [m];
    M qdd + h = B tau. Arguments `q`, `v` are (n,) arrays.
    """

    def __init__(
        self,
        arm: Arm,
        free_parameters: tuple[str, ...] = (),
        dtype: str = "float64",
        formulation: str = "gibbs_appell",
    ) -> None:
        self.arm, self.dtype, self.formulation = arm, dtype, formulation
        self._formed = formulation_for(arm, formulation)
        self.lanes = LANES_OF[dtype]  # environments that a batch steps side by side
        self.free_parameters = free_parameters
        self.names = list(arm.names)
        self.n, self.n_joint = arm.n, arm.n_joint
        bodies = chain_constants(arm)
        self._last = np.cumsum([len(link) for link in bodies]).tolist()  # one behind each link's
        links = tuple(body for link in bodies for body in link)
        rotation = "exp" if arm.rotation == "exp" else "linear"
        self.chain = Chain(links, arm.gravity, rotation)
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

    def __reduce__(self) -> Any:
        return Model, (self.arm, self.free_parameters, self.dtype, self.formulation)

    # ---- questions -----------------------------------------------------------------------------

    def mass_matrix(self, q: Array) -> Array:
        """(n, n) M at q."""
        return np.array(self._questions["mass_matrix"](self._q(q)))

    def bias(self, q: Array, v: Array) -> Array:
        """(n,) h: inertial, gravity, elastic and dissipative forces."""
        return np.array(self._questions["bias"](self._q(q), self._q(v, "v"))).ravel()

    def christoffel(self, q: Array, v: Array) -> Array:
        """(n, n) H: H v are the velocity terms of h, dM/dt - 2 H is skew-symmetric."""
        return np.array(self._christoffel(self._q(q), self._q(v, "v")))

    def accelerations(self, q: Array, v: Array, tau: Array) -> Array:
        """(n,) second derivatives under joint torques tau (n_joint,) [N m]."""
        program = self.program(1, "rk4")
        out = np.empty((1, self.n))
        program.evaluate_states(
            self._q(q)[None], self._q(v, "v")[None], self._tau(tau)[None],
            self.nominal_parameters[None], self.workspace(program), out,
        )  # fmt: skip
        return out[0]

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """(n,) generalized forces M a + h; motion under joint torques alone needs B tau."""
        return self.mass_matrix(q) @ self._q(a, "a") + self.bias(q, v)

    def energy(self, q: Array, v: Array) -> tuple[float, float, float]:
        """(kinetic, elastic, gravity) [J]; gravity is zero with all mass at the base's origin."""
        values = np.array(self._questions["energy"](self._q(q), self._q(v, "v"))).ravel()
        return float(values[0]), float(values[1]), float(values[2])

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
        if not 0 <= link < self.n_joint:
            raise ValueError(f"link must be 0 to {self.n_joint - 1}, got {link!r}.")
        described = self.arm.links[link]
        if not 0.0 <= x <= described.length:
            raise ValueError(f"x must be within the link, 0 to {described.length} m, got {x!r}.")
        segment = parts(described)[0]
        k = min(int(x / segment.length), described.segments - 1)
        _, delta = self.chain.split(self._q(q).tolist())[self._last[link] - described.segments + k]
        return np.asarray(delta) @ curvature(segment, x - k * segment.length)

    def frequencies(self, q: Array | None = None, joints: str = "locked") -> Array:
        """[rad/s] natural frequencies at the joint angles of q, undeflected, elastic forces only.

        joints="locked" holds the coordinates q_i; "free" leaves them free and omits the rigid
        motions.
        """
        if joints not in ("locked", "free"):
            raise ValueError(f"joints must be 'locked' or 'free', got {joints!r}.")
        rigid = self.rigid(np.zeros(self.n) if q is None else self._q(q))
        M: Array = np.array(
            self._formed.equations.mass_matrix(self.chain, [float(x) for x in rigid])
        )
        K = self.stiffness
        modal = np.setdiff1d(np.arange(self.n), self.arm.joint_index)
        if joints == "locked":
            M, K = M[np.ix_(modal, modal)], K[np.ix_(modal, modal)]
        from scipy.linalg import eigh

        squares = eigh(K, M, eigvals_only=True)
        return np.sqrt(np.abs(squares[squares.size - modal.size :]))

    def linearize(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """A (2n, 2n) and B (2n, n_joint) of d/dt (q, v) = A (q, v) + B tau about a state."""
        da = self._questions["jacobian"](self._q(q), self._q(v, "v"), self._tau(tau))
        dq, dv, dtau = (np.array(d) for d in da)
        n = self.n
        A = np.block([[np.zeros((n, n)), np.eye(n)], [dq, dv]])
        return A, np.vstack([np.zeros((n, self.n_joint)), dtau])

    def operation_count(self) -> dict[str, dict[str, int]]:
        """Operations of the traced arm, by running through its graphs."""
        graphs = {"accelerations": self.graph, "mass matrix and bias": self._M_h}
        return {name: operations(graph) for name, graph in graphs.items()}

    @cached_property
    def graph(self) -> Any:
        """CasADi Function (q, v, tau, parameters) -> accelerations."""
        return self._trace_accelerations(implicit=False)

    @cached_property
    def stiffness(self) -> Array:
        """(n, n) K, zero in the joints."""
        return linear.stiffness(self.chain)

    def rigid(self, q: Array) -> Array:
        """A copy of q, (n,) or (N, n), with every link straight."""
        straight = np.zeros_like(q)
        straight[..., list(self.arm.joint_index)] = q[..., list(self.arm.joint_index)]
        return straight

    # ---- compiled programs ---------------------------------------------------------------------

    def program(self, lanes: int, integrator: str, addition: Addition | None = None) -> ModuleType:
        """The generated module for a number of lanes and a method; from the cache where it can.

        `addition` replaces the stepper's measurements and entry points by others.
        """
        added = addition or self._stepping
        arm, free = json.dumps(self.arm.to_dict(), sort_keys=True), ",".join(self.free_parameters)
        key = fingerprint(
            arm, free, str(lanes), integrator, self.dtype, self.formulation, added.key
        )
        return cached_module(key, lambda: self._generate(lanes, integrator, added))

    def workspace(self, program: ModuleType) -> Array:
        """Scratch memory for one thread in `program`."""
        return np.zeros(program.SLOTS * int(program.LANES), dtype=self.dtype)

    def _generate(self, lanes: int, integrator: str, added: Addition) -> str:
        method = INTEGRATORS[integrator]
        sizes = {
            "Q": self.n, "V": self.n, "TAU": self.n_joint, "PARAMETERS": len(self.free_parameters),
            "IMPLICIT": 2 + self.n, "ACC": self.n, "SCRATCH": method.scratch(self.n), **added.sizes,
        }  # fmt: skip
        starts = np.cumsum([0, *sizes.values()]).tolist()
        at, implicit = dict(zip(sizes, starts, strict=False)), method.implicit
        inputs = [at["Q"], at["V"], at["TAU"], at["PARAMETERS"], at["IMPLICIT"]]
        graph = self._trace_accelerations(implicit) if implicit else self.graph
        functions = [
            render_function("accelerations", graph, inputs, at["ACC"]),
            *added.functions(at),
            *self._aid(method.aid, inputs, at["SCRATCH"]),
            f"METHOD = INTEGRATORS[{integrator!r}]",
        ]
        title = f"{self.arm.name or 'arm'}, {lanes} lanes, {integrator}, {self.dtype}"
        constants = at | {"N": self.n}
        work = functions[0].count(" = ")
        return render_module(title, lanes, starts[-1], work, constants, functions, added.entries)

    @property
    def _stepping(self) -> Addition:
        """What the stepper needs: measurements, and a check for numbers that are not finite."""

        def functions(at: Mapping[str, int]) -> list[str]:
            inputs = [at["Q"], at["V"]]
            return [render_function("measure", self.measure_graph, inputs, at["MEASURED"])]

        sizes = {"CHECK": 1, "GOOD": 1, "MEASURED": self.n_measure}
        return Addition(key="stepper", sizes=sizes, functions=functions, entries=GLUE)

    def _aid(self, aid: str, inputs: Sequence[int], scratch: int) -> list[str]:
        """Source of what a method needs beside the accelerations: AID."""
        if aid == "modes":
            modes = linear.frozen_modes(self.chain)  # none of a rigid arm: the shape must tell
            return [f"AID = np.array({modes.tolist()!r}).reshape({modes.shape})"]
        if aid == "jacobian":
            return [render_function("AID", self.jacobian_graph, inputs, scratch)]
        return ["AID = None"]

    # ---- tracing -------------------------------------------------------------------------------

    def _symbols(self) -> tuple[Any, Any, Any, Any]:
        import casadi as ca

        sizes = {"q": self.n, "v": self.n, "tau": self.n_joint, "p": len(self.free_parameters)}
        q, v, tau, p = (ca.SX.sym(name, size) for name, size in sizes.items())
        return q, v, tau, p

    def _traced_chain(self, p: Any) -> Chain:
        links = list(self.chain.links)
        for k, name in enumerate(self.free_parameters):
            links = FREE_PARAMETERS[name].apply(links, p[k])
        return replace(self.chain, links=tuple(links))

    def _trace_accelerations(self, implicit: bool) -> Any:
        import casadi as ca

        q, v, tau, p = self._symbols()
        extra = ca.SX.sym("implicit", 2 + self.n if implicit else 0)
        x = ca.vertsplit(extra)
        weights = Implicit(x[0], x[1], x[2:]) if implicit else None
        a = self._formed.accelerations(
            self._traced_chain(p), ca.vertsplit(q), ca.vertsplit(v), ca.vertsplit(tau), weights
        )
        return ca.Function("accelerations", [q, v, tau, p, extra], [ca.cse(ca.vertcat(*a))])

    @cached_property
    def jacobian_graph(self) -> Any:
        """CasADi Function (q, v, tau, parameters, nothing) -> da/dq, then da/dv, row by row."""
        import casadi as ca

        x = self.graph.sx_in()
        a = self.graph(*x)
        rows = [ca.vec(ca.densify(ca.jacobian(a, y)).T) for y in x[:2]]
        return ca.Function("jacobian", x, [ca.cse(ca.vertcat(*rows))])

    @cached_property
    def _M_h(self) -> Any:
        import casadi as ca

        q, v, _, _ = self._symbols()
        M = self._formed.equations.mass_matrix(self.chain, ca.vertsplit(q))
        h = self._formed.equations.bias(self.chain, ca.vertsplit(q), ca.vertsplit(v))
        lower = [x for i, row in enumerate(M) for x in row[: i + 1]]
        return ca.Function("M_h", [q, v], [ca.cse(ca.vertcat(*lower, *h))])

    @cached_property
    def measure_graph(self) -> Any:
        """CasADi Function (q, v) -> what `measurements` names."""
        import casadi as ca

        q, v, _, _ = self._symbols()
        x = ca.vertsplit(q)
        frames = outward(self.chain, x, ca.vertsplit(v))
        end = poses(frames)[-1]
        straight = [angle if i in self.arm.joint_index else 0.0 for i, angle in enumerate(x)]
        rigid = poses(outward(self.chain, straight, [0.0] * self.n))[-1].tip
        deflections, slopes, curvatures = [], [], []
        for link, first, last in zip(self.arm.links, [0, *self._last], self._last, strict=False):
            bodies = frames[first:last]
            tip = bodies[-1].r
            for outer, inner in zip(bodies[:0:-1], bodies[-2::-1], strict=True):
                tip = add(inner.r, matvec(outer.R, tip))
            theta = add(*(combine(f.delta, f.link.tip_theta) for f in bodies))
            bend = combine(bodies[0].delta, curvature(parts(link)[0], 0.0).tolist())
            shift = ca.vertcat(tip[0] - link.length, *tip[1:])
            deflections.append(ca.norm_2(shift) / link.length)
            slopes.append(ca.norm_2(ca.vertcat(*theta)))
            curvatures += [bend[2], bend[1]]
        velocity = self._formed.tip_velocity(self.chain, x, ca.vertsplit(v))
        values = [*end.tip, *velocity, *rigid, *deflections, *slopes, *curvatures]
        return ca.Function("measure", [q, v], [ca.cse(ca.vertcat(*values))])

    @cached_property
    def _questions(self) -> dict[str, Any]:
        """CasADi functions for the questions that nobody asks in a loop."""
        import casadi as ca

        q, v, tau, _ = self._symbols()
        x, rates = ca.vertsplit(q), ca.vertsplit(v)
        formed = self._formed
        M = formed.equations.mass_matrix(self.chain, x)
        a = ca.vertcat(*formed.accelerations(self.chain, x, rates, ca.vertsplit(tau)))
        derivatives = [ca.jacobian(a, x) for x in (q, v, tau)]
        graphs = {
            "mass_matrix": ([q], [ca.vertcat(*(ca.horzcat(*row) for row in M))]),
            "bias": ([q, v], [ca.vertcat(*formed.equations.bias(self.chain, x, rates))]),
            "energy": ([q, v], [ca.vertcat(*formed.energies(self.chain, x, rates))]),
            "jacobian": ([q, v, tau], derivatives),
        }
        return {name: ca.Function(name, inputs, out) for name, (inputs, out) in graphs.items()}

    @cached_property
    def _christoffel(self) -> Any:
        return christoffel(self._formed.equations, self.chain, self.n)

    def _measure(self, q: Array, v: Array) -> Array:
        return np.array(self.measure_graph(self._q(q), self._q(v, "v"))).ravel()

    def _q(self, x: Array, name: str = "q") -> Array:
        return _checked(x, self.n, name)

    def _tau(self, x: Array) -> Array:
        return _checked(x, self.n_joint, "tau")


def _checked(x: Array, size: int, name: str) -> Array:
    """A float64 array of the right size, or a sentence."""
    array = np.ascontiguousarray(x, dtype=np.float64)
    if array.shape != (size,):
        raise ValueError(f"{name} must have shape ({size},), got {array.shape}.")
    return array
