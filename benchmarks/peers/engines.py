"""Models of the peers' scenes in Exudyn and MuJoCo, set up with care for speed and accuracy.

A model is built once per run. A run returns the tip at the truth's times and the processor time of
its stepping loop alone, on one thread.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.peers.lines import Run
from benchmarks.peers.scenes import HEAVY, PeerScene
from dynamics.extras import missing
from dynamics.types import Array

setattr(sys, "exudynFast", True)  # Exudyn's build without range checks  # noqa: B010
try:
    import exudyn
    import exudyn.itemInterface as item
    import mujoco
    from exudyn import symbolic
    from mujoco.rollout import rollout
except ModuleNotFoundError as error:
    raise missing(error, "benchmarks.peers", "peers") from None

exudyn.config.printToConsole = False
exudyn.config.suppressWarnings = True
mujoco.set_mju_user_warning(lambda message: None)


class Stopped(RuntimeError):
    """An engine failed to complete a run."""


@dataclass(frozen=True)
class Cell:
    """A rigid piece of a link behind a hinge."""

    offset: float  # [m] from the previous hinge
    length: float  # [m]
    mass: float  # [kg]
    com: float  # [m] from its hinge
    inertia: float  # [kg m^2] about its center of mass
    rotor: float  # [kg m^2]
    stiffness: float  # [N m/rad]; zero at a joint of the arm
    angle: float  # [rad] at the start


def cells(scene: PeerScene, hinges: int) -> list[Cell]:
    """The arm as a chain: each link has a spring EI / dx in the middle of `hinges` equal parts."""
    chain: list[Cell] = []
    for link, angle in zip(scene.arm.links, scene.motion.joint_angles, strict=True):
        dx = link.length / hinges
        for k in range(hinges + 1):
            length = dx if 0 < k < hinges else 0.5 * dx
            mass, tip = link.rho_A * length, link.tip_mass if k == hinges else 0.0
            com = (0.5 * mass + tip) * length / (mass + tip)
            inertia = mass * length**2 / 12.0 + mass * (0.5 * length - com) ** 2
            chain.append(
                Cell(
                    offset=chain[-1].length if chain else 0.0, length=length, mass=mass + tip,
                    com=com, inertia=inertia + tip * (length - com) ** 2,
                    rotor=0.0 if k else link.joint.rotor_inertia,
                    stiffness=(link.EIz or 0.0) / dx if k else 0.0, angle=0.0 if k else angle,
                )
            )  # fmt: skip
    return chain


def chain_tips(chain: list[Cell], q: Array) -> Array:
    """(N, 2) [m] tip of a chain at its hinge angles (N, n)."""
    angles = np.cumsum(q, axis=1)
    length = np.array([cell.length for cell in chain])
    return np.stack([np.cos(angles) @ length, np.sin(angles) @ length], axis=1)


# ---- MuJoCo --------------------------------------------------------------------------------------

MUJOCO_METHODS = ("RK4", "Euler", "implicitfast", "discrete")


def mujoco_chain(
    scene: PeerScene, hinges: int, method: str, rate: Fraction, record: bool = True
) -> Run:
    """Run a chain of spring hinges; torques are applied forces per step, all in native code."""
    chain = cells(scene, hinges)
    bodies = "".join(
        f'<body pos="{c.offset!r} 0 0"><joint type="hinge" axis="0 0 1" armature="{c.rotor!r}"'
        f' stiffness="{c.stiffness!r}"/><inertial pos="{c.com!r} 0 0" mass="{c.mass!r}"'
        f' diaginertia="{c.inertia!r} {c.inertia!r} {c.inertia!r}"/>'
        for c in chain
    )
    gravity = " ".join(repr(x) for x in scene.arm.gravity)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{scene.step(rate)!r}" integrator="{method}"'
        f' gravity="{gravity}"><flag contact="disable" constraint="disable" actuation="disable"'
        f' sensor="disable"/></option><worldbody>{bodies}{"</body>" * len(chain)}</worldbody>'
        "</mujoco>"
    )
    data, torques = mujoco.MjData(model), scene.torques(rate)
    forces = np.zeros((1, torques.size, model.nv))
    forces[0, :, 0] = torques
    start = np.zeros((1, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    start[0, 1 : 1 + model.nq] = [cell.angle for cell in chain]
    states = np.empty((1, torques.size, start.size))
    sensors = np.empty((1, torques.size, 0))
    begin = time.process_time()
    rollout(
        model, data, start, forces, control_spec=mujoco.mjtState.mjSTATE_QFRC_APPLIED.value,
        state=states, sensordata=sensors, skip_checks=False,
    )  # fmt: skip
    seconds = time.process_time() - begin
    if any(warning.number for warning in data.warning):
        raise Stopped("MuJoCo's state left the finite numbers.")
    reached = states[0, rate.numerator - 1 :: rate.numerator, 1 : 1 + model.nq]
    return chain_tips(chain, reached), seconds


# ---- Exudyn --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class System:
    """An assembled Exudyn model."""

    mbs: Any
    set_torque: Callable[[float], None]
    tips: Callable[[Array], Array]  # sensor rows -> (N, 2) [m]
    sensor: Any


@dataclass(frozen=True)
class Method:
    """A time integration method of Exudyn."""

    solver: str
    radius: float = 1.0  # spectral radius at infinity
    tolerance: float = 1e-6  # of Newton's iterations

    @property
    def explicit(self) -> bool:
        """True if a step solves no equations."""
        return self.solver != "GeneralizedAlpha"


EXUDYN_METHODS = {
    "trapezoidal": Method("GeneralizedAlpha", tolerance=1e-4),
    "generalised-alpha 0.9": Method("GeneralizedAlpha", radius=0.9),
    "RK4": Method("RK44"),
    "Verlet": Method("VelocityVerlet"),
}


def cable(scene: PeerScene, elements: int, axial: float, explicit: bool) -> System:
    """ANCF cable elements; a heavy mass fixes the root, which is cheaper than constraints."""
    container = exudyn.SystemContainer()
    mbs = container.AddSystem()
    mbs.sys["container"] = container
    place, angle, nodes, last = np.zeros(2), 0.0, [], None
    for link, turn in zip(scene.arm.links, scene.motion.joint_angles, strict=True):
        angle += turn
        along, dx = np.array([np.cos(angle), np.sin(angle)]), link.length / elements
        nodes = [
            mbs.AddNode(
                item.NodePoint2DSlope1(referenceCoordinates=[*(place + k * dx * along), *along])
            )
            for k in range(elements + 1)
        ]
        for pair in pairwise(nodes):
            body = mbs.AddObject(
                item.ObjectANCFCable2D(
                    length=dx, massPerLength=link.rho_A, bendingStiffness=link.EIz,
                    axialStiffness=axial, nodeNumbers=list(pair), useReducedOrderIntegration=1,
                )
            )  # fmt: skip
            if any(scene.arm.gravity):
                marker = mbs.AddMarker(item.MarkerBodyMass(bodyNumber=body))
                load = item.LoadMassProportional(
                    markerNumber=marker, loadVector=list(scene.arm.gravity)
                )
                mbs.AddLoad(load)
        if last is None:
            root = nodes[0]
        else:
            for c in (0, 1):
                _equal(mbs, last, nodes[0], c)
        if link.tip_mass:
            _weigh(mbs, nodes[-1], [link.tip_mass, link.tip_mass, 0.0, 0.0])
        place, last = place + link.length * along, nodes[-1]
    set_torque = _drive(mbs, scene, root, explicit)
    sensor = mbs.AddSensor(
        item.SensorNode(
            nodeNumber=nodes[-1], storeInternal=True,
            outputVariableType=exudyn.OutputVariableType.Position,
        )
    )  # fmt: skip
    mbs.Assemble()
    return System(mbs, set_torque, lambda rows: rows[:, :2], sensor)


def _weigh(mbs: Any, node: Any, masses: list[float]) -> None:
    mbs.AddObject(item.ObjectGenericODE2(nodeNumbers=[node], massMatrix=np.diag(masses)))


def _equal(mbs: Any, a: Any, b: Any, coordinate: int) -> None:
    markers = [
        mbs.AddMarker(item.MarkerNodeCoordinate(nodeNumber=n, coordinate=coordinate))
        for n in (a, b)
    ]
    mbs.AddObject(item.CoordinateConstraint(markerNumbers=markers))


def _drive(mbs: Any, scene: PeerScene, root: Any, explicit: bool) -> Callable[[float], None]:
    """Fix the root's position; its slope has the hub's inertia, or turns as prescribed."""
    hub = scene.arm.links[0].joint.rotor_inertia
    if hub < HEAVY:
        _weigh(mbs, root, [HEAVY, HEAVY, hub, hub])
        marker = mbs.AddMarker(item.MarkerNodeRigid(nodeNumber=root))
        load = mbs.AddLoad(item.LoadTorqueVector(markerNumber=marker, loadVector=[0.0, 0.0, 0.0]))
        return lambda torque: mbs.SetLoadParameter(load, "loadVector", [0.0, 0.0, torque])
    slope = HEAVY if explicit else 0.0
    _weigh(mbs, root, [HEAVY, HEAVY, slope, slope])
    for c in (2, 3):
        marker = mbs.AddMarker(item.MarkerNodeCoordinate(nodeNumber=root, coordinate=c))
        if explicit:
            _force(mbs, marker, partial(_slope_force, c))
        else:
            _prescribe(mbs, marker, partial(_slope_change, c))
    return lambda torque: None


def _slope_force(coordinate: int, t: Any) -> Any:
    """Torque that turns a heavy slope as prescribed [N m]."""
    return HEAVY * direction(t)[coordinate]


def _slope_change(coordinate: int, t: Any) -> Any:
    """Change of a slope's coordinate 2 or 3 since the start [-]."""
    return direction(t)[coordinate - 2] - (1.0 if coordinate == 2 else 0.0)


def spin(t: Any) -> tuple[Any, Any, Any]:
    """Angle [rad], rate and acceleration of S3's root as Exudyn's symbols."""
    w = 2.0 * np.pi / 15.0
    early = t < 15.0
    angle = 0.4 * (0.5 * t * t + (symbolic.cos(w * t) - 1.0) / w**2)
    rate = 0.4 * (t - symbolic.sin(w * t) / w)
    acceleration = 0.4 * (1.0 - symbolic.cos(w * t))
    return (
        symbolic.IfThenElse(early, angle, 6.0 * t - 45.0),
        symbolic.IfThenElse(early, rate, 0.0 * t + 6.0),
        symbolic.IfThenElse(early, acceleration, 0.0 * t),
    )


def direction(t: Any) -> tuple[Any, Any, Any, Any]:
    """x and y of the root's direction, and their second derivatives [1/s^2]."""
    angle, rate, acceleration = spin(t)
    x, y = symbolic.cos(angle), symbolic.sin(angle)
    square = rate * rate
    return x, y, 0.0 - y * acceleration - x * square, x * acceleration - y * square


def _force(mbs: Any, marker: Any, force: Callable[[Any], Any]) -> None:
    load = mbs.AddLoad(item.LoadCoordinate(markerNumber=marker, load=0.0))
    function = exudyn.advancedUtilities.CreateSymbolicUserFunction(
        mbs, lambda mbs, t, load: force(t), "loadUserFunction", load
    )
    mbs.SetLoadParameter(load, "loadUserFunction", function)
    mbs.sys.setdefault("kept", []).append(function)


def _prescribe(mbs: Any, marker: Any, offset: Callable[[Any], Any]) -> None:
    ground = mbs.AddMarker(
        item.MarkerNodeCoordinate(nodeNumber=mbs.AddNode(item.NodePointGround()), coordinate=0)
    )
    constraint = mbs.AddObject(item.CoordinateConstraint(markerNumbers=[ground, marker]))
    function = exudyn.advancedUtilities.CreateSymbolicUserFunction(
        mbs, lambda mbs, t, itemNumber, lOffset: offset(t), "offsetUserFunction", constraint
    )
    mbs.SetObjectParameter(constraint, "offsetUserFunction", function)
    mbs.sys.setdefault("kept", []).append(function)


def tree(scene: PeerScene, hinges: int) -> System:
    """The chain of hinges as a kinematic tree in minimal coordinates."""
    container = exudyn.SystemContainer()
    mbs = container.AddSystem()
    mbs.sys["container"] = container
    chain = cells(scene, hinges)
    n = len(chain)
    node = mbs.AddNode(
        item.NodeGenericODE2(
            referenceCoordinates=[0.0] * n, initialCoordinates=[c.angle for c in chain],
            initialCoordinates_t=[0.0] * n, numberOfODE2Coordinates=n,
        )
    )  # fmt: skip
    frames, inertias = exudyn.Matrix3DList(), exudyn.Matrix3DList()
    offsets, centres = exudyn.Vector3DList(), exudyn.Vector3DList()
    for c in chain:
        frames.Append(np.eye(3))
        inertias.Append(np.diag([0.0, 0.0, c.inertia + c.rotor]))
        offsets.Append([c.offset, 0.0, 0.0])
        centres.Append([c.com, 0.0, 0.0])
    none = [0.0] * n
    mbs.AddObject(
        item.ObjectKinematicTree(
            nodeNumber=node, gravity=list(scene.arm.gravity),
            jointTypes=[exudyn.JointType.RevoluteZ] * n, linkParents=list(range(-1, n - 1)),
            jointTransformations=frames, jointOffsets=offsets, linkInertiasCOM=inertias,
            linkCOMs=centres, linkMasses=[c.mass for c in chain], jointForceVector=none,
            jointPControlVector=[c.stiffness for c in chain], jointPositionOffsetVector=none,
            jointDControlVector=none, jointVelocityOffsetVector=none,
        )
    )  # fmt: skip
    marker = mbs.AddMarker(item.MarkerNodeCoordinate(nodeNumber=node, coordinate=0))
    hub = chain[0].rotor
    if hub < HEAVY:
        load = mbs.AddLoad(item.LoadCoordinate(markerNumber=marker, load=0.0))
    else:
        _force(mbs, marker, lambda t: (HEAVY + 400.0) * spin(t)[2])
    sensor = mbs.AddSensor(
        item.SensorNode(
            nodeNumber=node, storeInternal=True,
            outputVariableType=exudyn.OutputVariableType.Coordinates,
        )
    )  # fmt: skip
    mbs.Assemble()

    def set_torque(torque: float) -> None:
        if hub < HEAVY:
            mbs.SetLoadParameter(load, "load", torque)

    return System(mbs, set_torque, lambda rows: chain_tips(chain, rows), sensor)


def follow(
    system: System, scene: PeerScene, method: Method, rate: Fraction, record: bool = True
) -> Run:
    """Integrate from one torque jump to the next; store the tips only with `record`."""
    mbs, seconds, rows = system.mbs, 0.0, []
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    settings.solution.sensors.active = record
    settings.solution.sensors.writePeriod = scene.step(rate) * rate.numerator
    times = settings.timeIntegration
    times.solverType = getattr(exudyn.DynamicSolverType, method.solver)
    times.adaptiveStep = False
    times.newton.relativeTolerance = times.newton.absoluteTolerance = method.tolerance
    times.generalizedAlpha.spectralRadius = method.radius
    times.explicit.computeEndOfStepAccelerations = False
    for begin, end in pairwise(scene.motion.knots):
        torque = scene.motion.torque
        system.set_torque(0.0 if torque is None else float(np.asarray(torque(begin))[0]))
        times.startTime, times.endTime = begin, end
        times.numberOfSteps = round((end - begin) / scene.step(rate))
        implicit = not method.explicit
        solver = exudyn.MainSolverImplicitSecondOrder() if implicit else exudyn.MainSolverExplicit()
        solver.InitializeSolver(mbs, settings)
        clock = time.process_time()
        try:
            solved = solver.SolveSteps(mbs, settings)
        except exudyn.ExudynError as error:
            raise Stopped(str(error)) from error
        seconds += time.process_time() - clock
        solver.FinalizeSolver(mbs, settings)
        if not solved:
            raise Stopped(f"Newton's iterations failed before {end} s.")
        state = mbs.systemData.GetSystemState(configuration=exudyn.ConfigurationType.Current)
        mbs.systemData.SetSystemState(state, configuration=exudyn.ConfigurationType.Initial)
        if record:
            rows.append(mbs.GetSensorStoredData(system.sensor)[1:, 1:])
    return (system.tips(np.vstack(rows)) if record else np.empty((0, 2))), seconds
