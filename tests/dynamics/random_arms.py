"""Arms that nobody would build, so that no term of the recursion can hide, and states of them."""

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from dynamics import Arm, Base, Joint, Link, Mode, Model, Payload, compile_arm
from dynamics.description.arm import FOURTH_ORDER
from dynamics.description.mode_shapes import FREE_ROOT, shape
from dynamics.types import Array

Matrix = tuple[tuple[float, ...], ...]

KINDS = {
    "y": (
        "clamped-free",
        "pinned-free",
        "clamped-tip-mass",
        "unconstrained",
        "poly",
        "hierarchical",
    ),
    "z": ("clamped-free", "clamped-tip-mass", "poly", "hierarchical"),
    "x": ("torsion-fixed-free", "torsion-poly"),
    "axial": ("axial-fixed-free", "axial-poly"),
}
TURN = 0.1  # [rad] what one mode may turn the tip, or [-] move it over the length


def random_arm(seed: int, n_link: int, n_mode: int, *, spatial: bool = True) -> Arm:
    """A valid arm with everything in it: the first link has `n_mode` modes, others fewer or none.

    Mixed kinds, directions, torsion, mountings, offsets, tip bodies, rotors, hubs, friction,
    damping, gravity, payload, segments, lumped masses, foreshortening. Not `spatial`: all in the
    x-y plane, without torsion.
    """
    rng = np.random.default_rng([seed, n_link, n_mode])
    counts = [n_mode, *rng.integers(0, n_mode + 1, n_link - 1)]
    return Arm(
        name=f"random {seed}",
        links=tuple(_link(rng, int(m), spatial) for m in counts),
        gravity=tuple(rng.normal(0.0, 6.0, 3) * (1.0, 1.0, spatial)),
        payload=Payload(mass=0.3, inertia=_inertia(rng, spatial)) if rng.random() < 0.5 else None,
        foreshortening=(False, False, True, FOURTH_ORDER)[rng.integers(4)],
    )


def flying(arm: Arm, seed: int = 0) -> Arm:
    """The arm on a free base as light as itself, its centre of mass aside."""
    rng = np.random.default_rng([seed, 11])
    root = rng.normal(0.0, 0.5, (3, 3))
    spread = root @ root.T + 0.05 * np.eye(3)
    base = Base(
        type="free",
        mass=rng.uniform(1.0, 5.0),
        com=tuple(rng.normal(0.0, 0.2, 3)),
        inertia=tuple(map(tuple, np.trace(spread) * np.eye(3) - spread)),
        position=tuple(rng.normal(0.0, 1.0, 3)),
        quaternion=tuple(np.roll(Rotation.random(random_state=rng).as_quat(), 1)),
        velocity=tuple(rng.normal(0.0, 1.0, 3)),
        angular_velocity_body=tuple(rng.normal(0.0, 2.0, 3)),
    )
    return replace(arm, base=base)


def random_state(arm: Arm, seed: int = 0) -> tuple[Array, Array]:
    """Coordinates and rates: any joint angles, moderate deflections."""
    rng = np.random.default_rng([seed, arm.n])
    sizes = np.array(
        [
            x
            for k in arm.links
            for x in (*[0.0] * k.joint.moves, *[TURN] * k.joint.elastic, *_amplitudes(k))
        ]
    )
    sizes = np.concatenate([np.zeros(arm.base.n), sizes])
    q, v = rng.uniform(-1.0, 1.0, (2, arm.n)) * (sizes, 20.0 * sizes)
    joints = list(arm.joint_index)
    q[joints] = rng.uniform(-np.pi, np.pi, arm.n_joint)
    v[joints] = rng.normal(0.0, 2.0, arm.n_joint)
    six = slice(0, arm.base.n)
    q[six], v[six] = rng.normal(0.0, 1.0, (2, arm.base.n))
    return q, v


def random_torque(arm: Arm, seed: int = 0) -> Array:
    """(n_joint,) [N m]."""
    return np.random.default_rng([seed, 7]).normal(0.0, 5.0, arm.n_joint)


def two_link_spatial(**changes: object) -> Arm:
    """Perpendicular joints, bending in both planes and torsion: n = 7."""
    joint = Joint(rotor_inertia=0.05, viscous=0.1)
    link = Link(
        length=0.8, rho_A=1.2, EIz=60.0, EIy=90.0, GJ=40.0, rho_Ip=0.004, tip_mass=0.5,
        tip_inertia=_diagonal(0.004, 0.005, 0.006), damping_beta=2e-4, joint=joint,
        modes=(
            Mode(kind="clamped-free", index=1, direction="y"),
            Mode(kind="clamped-free", index=1, direction="z"),
        ),
    )  # fmt: skip
    torsion = Mode(kind="torsion-fixed-free", index=1, direction="x")
    first = replace(link, modes=(*link.modes, torsion))
    across = replace(joint, rotation=((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)))
    second = replace(link, length=0.6, joint=across)
    values = {"links": (first, second), "gravity": (0.0, 0.0, -9.81), "name": "two spatial links"}
    return Arm(**{**values, **changes})


def undamped(arm: Arm) -> Arm:
    """Without friction and damping."""
    links = tuple(
        replace(
            link, damping_beta=0.0, damping_ratio=0.0,
            joint=replace(link.joint, viscous=0.0, coulomb=0.0),
        )
        for link in arm.links
    )  # fmt: skip
    return replace(arm, links=links)


@cache
def compiled(arm: Arm, *free_parameters: str) -> Model:
    """One model per arm and session."""
    return compile_arm(arm, free_parameters=free_parameters)


def floats(x: Array) -> list[float]:
    """Plain floats, on which the recursion runs as the slow reference."""
    return [float(value) for value in x]


def torque_matrix(arm: Arm) -> Array:
    """(n, n_joint) B: a joint torque also turns the root of shapes that are not clamped."""
    B = np.zeros((arm.n, arm.n_joint))
    row = arm.base.n
    i = -1
    for link in arm.links:
        i += link.joint.moves
        if not link.joint.moves:
            row += link.n
            continue
        B[row, i] = 1.0
        for j, mode in enumerate(link.modes, 1):
            if mode.direction == "y" and not link.joint.elastic:
                B[row + j, i] = shape(mode, link.beam).slope(0.0)
        row += 1 + link.joint.elastic + link.segments * len(link.modes)
    return B


def _link(rng: Generator, count: int, spatial: bool) -> Link:
    directions = rng.choice(["y", "z", "x"] if spatial else ["y"], count).tolist()
    if spatial and directions.count("y") > 1:
        directions[directions.index("y")] = "axial"
    modes = []
    for direction in sorted(set(directions)):
        kind = str(rng.choice(KINDS[direction]))
        modes += [
            Mode(kind=kind, index=index, direction=direction, norm=_norm(rng))
            for index in range(1, directions.count(direction) + 1)
        ]
    mounting = Rotation.random(random_state=rng).as_matrix() if spatial else np.eye(3)

    def maybe(most: float) -> float:
        return float(rng.uniform(0.0, most) * (rng.random() < 0.6))

    weldable = count < 3 and all(mode.kind not in FREE_ROOT for mode in modes)
    most = {"x": 1, "y": 2, "z": 2, "axial": 1}
    few = all(directions.count(d) <= most[d] for d in directions)
    lumped = weldable and few and rng.random() < 0.4
    damping = {"damping_beta": 1e-4} if rng.random() < 0.5 else {"damping_ratio": 0.02}
    return Link(
        length=rng.uniform(0.3, 1.0),
        rho_A=rng.uniform(0.5, 4.0),
        EIz=rng.uniform(20.0, 300.0),
        EIy=rng.uniform(20.0, 300.0),
        GJ=rng.uniform(20.0, 300.0),
        EA=rng.uniform(200.0, 3000.0),
        rho_Ip=rng.uniform(0.01, 0.04) * spatial,
        tip_mass=maybe(1.0),
        tip_inertia=_inertia(rng, spatial),
        modes=tuple(modes[int(k)] for k in rng.permutation(count)),
        segments=int(rng.integers(1, 3)) if weldable else 1,
        lumped=bool(lumped),
        **damping,
        joint=Joint(
            rotation=tuple(map(tuple, mounting)),
            offset=tuple(rng.normal(0.0, 0.1, 3) * (1.0, 1.0, spatial)),
            rotor_inertia=maybe(0.3),
            hub_inertia=maybe(0.3),
            viscous=maybe(1.0),
            coulomb=maybe(1.0),
            coulomb_speed=0.3,
        ),
    )


def _norm(rng: Generator) -> str:
    return str(rng.choice(["tip-unit", "mass", "raw"]))


def _inertia(rng: Generator, spatial: bool) -> Matrix:
    if not spatial:
        return _diagonal(0.0, 0.0, rng.uniform(0.0, 0.02))
    root = rng.normal(0.0, 0.1, (3, 3))
    return tuple(map(tuple, root @ root.T))


def _diagonal(*values: float) -> Matrix:
    return tuple(map(tuple, np.diag(values)))


def _amplitudes(link: Link) -> list[float]:
    """Modal amplitudes of a moderate deflection anywhere along a link."""
    part = replace(link, length=link.length / link.segments, segments=1)
    found = []
    for mode in part.modes:
        s = shape(mode, part.beam)
        x = np.linspace(0.0, part.length, 9)
        value, slope = float(np.abs(s.value(x)).max()), float(np.abs(s.slope(x)).max())
        found.append(TURN / (value if mode.direction == "x" else max(slope, value / part.length)))
    return link.segments * found
