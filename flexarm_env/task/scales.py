"""Scales that an environment derives from its arm: torque limits, natural scales, step sizes.

All follow from the model linearized at rest, links straight: M a + C v + K q = B tau. The torque
limits come from a bang-bang test: every joint takes its full torque for half a period of the first
joint-free mode, the opposite torque for the other half, then none. A floating base has neither
forces nor springs, so it is eliminated: M is that of joints and modes at zero momentum.

Against gravity every joint has two torques: one that holds it in any posture of the tasks, and one
for motion, whose bang-bang test leaves room for the sag. The torque limit is their sum.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.formulations.damping import damped_chain
from dynamics.formulations.gibbs_appell import mass_matrix
from dynamics.formulations.kinematics import outward, poses
from dynamics.formulations.linearized import damping, friction
from dynamics.integrators.table import INTEGRATORS
from dynamics.model import Model
from dynamics.simulation import step_limits
from dynamics.simulation.statics import held, sag
from dynamics.types import Array

DEFLECTION_LIMIT = 0.1  # [-] tip deflection of a link over its length; beyond, the model is invalid
SLOPE_PER_DEFLECTION = 1.6  # [rad] tip slope of a beam whose first shape deflects the tip by the
# beam's length: 1.38 rad clamped and bare, 1.57 rad on a free, light hub
BENT = 0.6  # [rad] home angle of every joint but the first
EXTENT = 1.3  # [rad] farthest joint angle from home: of all starts, targets and paths of the tasks
MOVE = 0.5  # [rad] angle scale: the angle of the bang-bang move that sets rate and time scales
RIGID_PERIOD = 0.5  # [s] in place of the first joint-free one, of an arm without modes
RIGID_RATE = 25.0  # [rad/s] of motions of an arm without flexible links
RIGID_ACCELERATION = 10.0  # [rad/s^2] at full torque, for an arm without flexible links
LINEAR = 0.97  # share of validity in the bang-bang test, which is linear: bent links bend more
LEAST_MOTION = 0.3  # of validity: left to motion however far gravity bends the links
SLOW = 10.0  # frequency over the first of the slow natural modes, which Damp excites
SAFE = 0.75  # of a method's stability limit: a pose may raise the highest frequency
POSTURES = 6  # of the tasks in which a step by rule is stable, besides home and stretched
SMOOTH = {1: 0.003, 2: 0.03, 4: 0.5}  # largest dt omega by a method's order, omega of the first
# joint-free mode: moves excite it, and a step must follow it to 1e-3 of the reach
BY_RULE = ("rk4", "midpoint")  # SMOOTH is not enough for Numerov's method: it has to be measured
_UNMOVED = 1e-9  # [-] of the largest peak: a mode that torques do not excite; of the reach: a tip
_SAMPLES = 200  # per period of the first joint-free mode


@dataclass(frozen=True)
class Scales:
    """Scales of an arm.

    Natural frequencies are "locked" with the joints locked, "free" with the joints free. n_modal
    coordinates are neither joints nor of a base.
    """

    home: tuple[float, ...]  # (n_joint,) [rad] a posture away from the stretched one
    # (n_joint,) [N m] holding torque, and torque that keeps the bang-bang test valid
    torque_limit: tuple[float, ...]
    holding: tuple[float, ...]  # (n_joint,) [N m] largest against gravity in postures of the tasks
    sag: float  # [-] largest static bending under gravity in these postures, over what is valid
    # (n_joint,) [kg m^2] about each joint, all else locked but a floating base
    inertia: tuple[float, ...]
    locked: tuple[float, ...]  # [rad/s] natural frequencies
    free: tuple[float, ...]  # [rad/s] natural frequencies, rigid motions left out
    fastest: float  # [rad/s] highest frequency, or fastest decay [1/s] by damping and friction
    modal_scale: tuple[float, ...]  # (n_modal,) [m] peak in the bang-bang test; 1 if unmoved
    modal_rate: tuple[float, ...]  # (n_modal,) [m/s] peak rate in the test; 1 if unmoved
    # modal amplitudes [m] and rates [m/s] at the peaks of the slow natural modes with locked joints
    vibration: tuple[tuple[float, ...], ...]  # (r, n_modal)
    vibration_rate: tuple[tuple[float, ...], ...]  # (r, n_modal)
    # () or (2,) [m], [rad] travel and turn of a floating base per radian of all joints' motion
    base: tuple[float, ...]

    @property
    def motion_torque(self) -> Array:
        """(n_joint,) [N m] that is left for motion at full torque."""
        return np.array(self.torque_limit) - self.holding


def home_posture(n_joint: int) -> tuple[float, ...]:
    """Joint angles [rad] away from the stretched posture."""
    return (0.0,) + (BENT,) * (n_joint - 1)


@lru_cache(maxsize=64)
def scales(arm: Arm) -> Scales:
    """Scales of an arm; refuses an arm with a joint that does not turn."""
    for i, link in enumerate(arm.links, 1):
        if link.joint.type == "prismatic":
            raise ValueError(
                f"Environments take arms whose joints turn, but joint {i} is {link.joint.type}; "
                "follow such an arm with dynamics.simulate."
            )
    if not arm.n_joint:
        raise ValueError(
            "Environments take arms with a joint that turns, got only fixed joints; give one the "
            'type "revolute".'
        )
    with validate.double_precision("The arm's frequencies and scales"):
        return _derived(arm)


def _derived(arm: Arm) -> Scales:
    model, base = Model(arm), arm.base.n
    home = home_posture(arm.n_joint)
    q = np.zeros(arm.n)
    q[list(arm.joint_index)] = home
    _refuse_still_tip(model, q)
    joints = [i - base for i in arm.joint_index]
    n = arm.n - base
    modal = [i for i in range(n) if i not in joints]
    whole = np.array(mass_matrix(model.chain, q.tolist()), dtype=np.float64)
    M = _without_base(whole, base)
    K = model.stiffness[base:, base:]
    C = (damping(model.chain) + friction(model.chain))[base:, base:]
    decay = float(np.linalg.eigvals(np.linalg.solve(M, C)).real.max())
    inertia = np.diag(M)[joints]
    locked = _frequencies(M[np.ix_(modal, modal)], K[np.ix_(modal, modal)])
    free = _frequencies(M, K)[arm.n_joint :]
    shapes = _slow_modes(M, K, modal)
    load = held(arm, np.array(home), EXTENT)
    bent, room = 0.0, 1.0  # by gravity; left for motion
    if modal:
        acceleration, peak, swing = _bang_bang(arm, M, K, inertia, float(free[0]), shapes)
        static = _sags(model, load.postures) if any(arm.gravity) else np.zeros((1, arm.n))
        strains = _damping_inputs_strains(arm)[2]
        bent = float(np.linalg.norm(strains @ static.T, axis=1).max(initial=0.0))
        room = max(LINEAR - bent, LEAST_MOTION) / LINEAR
        acceleration, peak, swing = room * acceleration, room * peak, room * swing
        peak[:n] += np.abs(static).max(axis=0)[base:]
        scale = np.where(peak > _UNMOVED * peak.max(), peak, 1.0)
    else:
        acceleration, scale, swing = RIGID_ACCELERATION, np.zeros(0), np.zeros(0)
    vibration = swing.reshape(2, -1, 1) * shapes[:, modal]
    return Scales(
        home=home,
        torque_limit=tuple(
            float(f"{two_digits(acceleration * x) + _three_digits_up(h):.6g}")
            for x, h in zip(inertia, load.torque.tolist(), strict=True)
        ),
        holding=tuple(load.torque.tolist()),
        sag=bent,
        inertia=tuple(inertia.tolist()),
        locked=tuple(locked.tolist()),
        free=tuple(free.tolist()),
        fastest=max((decay, *locked.tolist(), *free.tolist())),
        modal_scale=tuple(scale[modal].tolist()),
        modal_rate=tuple(scale[[n + i for i in modal]].tolist()),
        vibration=tuple(map(tuple, vibration[0].tolist())),
        vibration_rate=tuple(map(tuple, vibration[1].tolist())),
        base=_recoil(whole, base, list(arm.joint_index)),
    )


def _refuse_still_tip(model: Model, q: Array) -> None:
    """Refuse an arm whose tip lies on the axes of all joints: they turn about it in any posture."""
    rates = np.eye(model.n)[list(model.arm.joint_index)]
    moved = [poses(outward(model.chain, q.tolist(), v.tolist()))[-1].tip_velocity for v in rates]
    if np.abs(np.array(moved)).max() <= _UNMOVED * model.arm.reach:
        last = model.arm.links[-1]
        raise ValueError(
            "Environments take arms with a tip that a joint moves, got one on the axes of all "
            f"joints; give the last link a length (Link.length is {last.length!r}) or a "
            f"Joint.root (is {last.joint.root!r}), or of a URDF file another tip."
        )


def _without_base(M: Array, base: int) -> Array:
    """Mass matrix of joints and modes where the first `base` coordinates move without a force."""
    if not base:
        return M
    coupling = M[:base, base:]
    result: Array = M[base:, base:] - coupling.T @ np.linalg.solve(M[:base, :base], coupling)
    return result


def _recoil(M: Array, base: int, joints: list[int]) -> tuple[float, ...]:
    """() or (2,) [m], [rad] travel and turn of the base per radian of all joints' motion."""
    if not base:
        return ()
    per_joint = np.linalg.solve(M[:base, :base], M[:base, joints])
    travel, turn = np.linalg.norm(per_joint[:2], axis=0), np.abs(per_joint[2])
    return float(travel.sum()), float(turn.sum())


def _sags(model: Model, postures: Array) -> Array:
    """(N, n) static deflections at joint angles (N, n_joint) [rad]."""
    return np.array([sag(model, angles) for angles in postures])


def two_digits(x: float) -> float:
    """Round down to two significant digits, so that a limit is easy to quote."""
    unit = 10.0 ** (math.floor(math.log10(x)) - 1)
    return float(f"{math.floor(x / unit * (1.0 + 1e-9)) * unit:.2g}")


def _three_digits_up(x: float) -> float:
    unit = 10.0 ** (math.floor(math.log10(x)) - 2) if x else 1.0
    return math.ceil(x / unit * (1.0 - 1e-9)) * unit


def _frequencies(M: Array, K: Array) -> Array:
    """[rad/s] natural frequencies of M a + K q = 0, ascending."""
    inverse = np.linalg.inv(np.linalg.cholesky(M)) if M.size else M
    return np.sqrt(np.abs(np.linalg.eigvalsh(inverse @ K @ inverse.T)))


def _exponential(A: Array) -> Array:
    """exp(A): a Taylor series of A / 2^k, squared k times."""
    k = max(0, math.ceil(math.log2(max(1e-300, float(np.abs(A).sum(axis=1).max())))) + 1)
    X = A / 2.0**k
    result = np.eye(len(A))
    for j in range(18, 0, -1):  # Horner's rule; X below 1/2: error below 1e-22
        result = np.eye(len(A)) + X @ result / j
    for _ in range(k):
        result = result @ result
    return result


def _slow_modes(M: Array, K: Array, modal: list[int]) -> Array:
    """(r, n) natural modes with locked joints and modal mass 1, up to SLOW times the first."""
    shapes = np.zeros((0, len(M)))
    if modal:
        inverse = np.linalg.inv(np.linalg.cholesky(M[np.ix_(modal, modal)]))
        squares, turned = np.linalg.eigh(inverse @ K[np.ix_(modal, modal)] @ inverse.T)
        slow = squares <= SLOW**2 * squares[0]
        shapes = np.zeros((np.count_nonzero(slow), len(M)))
        shapes[:, modal] = (inverse.T @ turned[:, slow]).T
    return shapes


def _bang_bang(
    arm: Arm, M: Array, K: Array, inertia: Array, first: float, shapes: Array
) -> tuple[float, Array, Array]:
    """Largest valid acceleration [rad/s^2] in the bang-bang test, and what it moves.

    These are the peaks of q and v (2 n,), and those of the amplitudes and rates of the r natural
    modes `shapes` (2 r,), reduced so that all amplitudes together are valid. Joint torques are the
    acceleration times `inertia`. One period of bang-bang at `first` [rad/s], the first joint-free
    frequency, excites that mode most. All joints move at once and their peaks add up.
    """
    base, m = arm.base.n, arm.n_joint
    n = arm.n - base
    C, B, strains = _damping_inputs_strains(arm)
    C, B, strains = C[base:, base:], B[base:], strains[:, :, base:]
    dt = 2.0 * math.pi / first / _SAMPLES
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ C]])
    forces = np.vstack([np.zeros((n, m)), inverse @ B * inertia])  # per unit acceleration
    step = _exponential(np.block([[A, forces], [np.zeros((m, 2 * n + m))]]) * dt)
    x = np.zeros((2 * n, m))  # one column per joint that is driven alone
    peak_strain, peak = np.zeros((len(strains), m)), np.zeros((2 * n, m))
    swing = np.zeros((2, len(shapes), m))
    amplitudes = shapes @ M
    amplitudes[:, [i - base for i in arm.joint_index]] = 0.0  # of the modes with locked joints
    for k in range(2 * _SAMPLES):
        sign = 1.0 if k < _SAMPLES // 2 else -1.0 if k < _SAMPLES else 0.0
        x = step[: 2 * n, : 2 * n] @ x + sign * step[: 2 * n, 2 * n :]
        peak_strain = np.maximum(peak_strain, np.linalg.norm(strains @ x[:n], axis=1))
        peak = np.maximum(peak, np.abs(x))
        swing = np.maximum(swing, np.abs(amplitudes @ x.reshape(2, n, m)))
    largest = float(peak_strain.sum(axis=1).max())
    acceleration = LINEAR / largest if largest else RIGID_ACCELERATION  # springs alone: any twist
    swing = acceleration * swing.sum(axis=2)
    bent = np.linalg.norm(np.einsum("acn,rn->acr", strains, shapes), axis=1)
    together = float((bent @ swing[0]).max(initial=1.0))
    return acceleration, acceleration * peak.sum(axis=1), swing.ravel() / together


def _damping_inputs_strains(arm: Arm) -> tuple[Array, Array, Array]:
    """Matrices of the bang-bang test.

    (n, n) modal and spring damping; (n, n_joint) generalized forces of unit joint torques; and
    (2 n_link, 3, n) tip deflection and tip slope of each link, over their limits of validity.
    """
    n, count = arm.n, len(arm.links)
    C, B = np.zeros((n, n)), np.zeros((n, arm.n_joint))
    deflection, slope = np.zeros((count, 3, n)), np.zeros((count, 3, n))
    links, dampers = damped_chain(arm)
    for damper in dampers:
        rows = slice(damper.first, damper.first + len(damper.u))
        C[rows, rows] += damper.rate * np.outer(damper.u, damper.u)
    stop, joint = arm.base.n, -1
    for i, (link, bodies) in enumerate(zip(arm.links, links, strict=True)):
        for k, body in enumerate(bodies, 1):
            joint += body.driven
            start, stop = stop, stop + (not body.welded)
            if body.driven:
                B[start, joint] = 1.0
            elif not body.welded:
                C[start, start] = body.viscous  # of a joint's spring
            size = len(body.K)
            modes = slice(stop, stop + size)
            stop += size
            if not size:
                continue  # a rotor, or the carrier of a root beside its joint
            theta = np.array(body.tip_theta).reshape(size, 3)
            beyond = (len(bodies) - k) * body.length  # [m] of the link behind this segment
            shift = np.array(body.tip_phi)[:size].reshape(size, 3)
            shift = shift + np.cross(theta, (beyond, 0.0, 0.0))
            C[modes, modes] += np.array(body.damping).reshape(size, size)
            if body.driven:
                B[modes, joint] = body.root_slope
            deflection[i, :, modes] = shift.T / link.length / DEFLECTION_LIMIT
            slope[i, :, modes] = theta.T / (SLOPE_PER_DEFLECTION * DEFLECTION_LIMIT)
    return C, B, np.concatenate([deflection, slope])


def integration(arm: Arm, control_dt: float, integrator: str | None = None) -> tuple[str, int]:
    """Integrator and substeps per control step that keep the tip within 1e-3 of the reach.

    A rule for arms whose steps were never measured (see flexarm_env/certify). Without `integrator`
    it takes the method of BY_RULE with the fewest evaluations of the accelerations. The steps are
    stable in postures of the tasks, friction of the joints included.
    """
    found = scales(arm)
    first = min(found.free, default=RIGID_RATE)

    def steps(name: str) -> int:
        method = INTEGRATORS[name]
        stable = found.fastest / (SAFE * method.limit)
        return max(1, math.ceil(control_dt * max(stable, first / SMOOTH[method.order]) - 1e-9))

    names = BY_RULE if integrator is None else (integrator,)
    counts = {name: stable_steps(arm, control_dt, name, steps(name)) for name in names}
    return min(counts.items(), key=lambda item: INTEGRATORS[item[0]].evaluations(item[1]))


@lru_cache(maxsize=64)
def stable_steps(arm: Arm, control_dt: float, integrator: str, least: int) -> int:
    """Steps per control step, at least `least`, that are stable for small motions about rest.

    Looked at are the home posture, the stretched one and POSTURES others of the tasks. Where
    `least` steps are not stable there, of implicit methods with the margin SAFE, more leave it.
    """
    model, home, joints = Model(arm), np.array(home_posture(arm.n_joint)), list(arm.joint_index)
    others = np.random.default_rng(0).uniform(-EXTENT, EXTENT, (POSTURES, arm.n_joint))
    margin = SAFE if INTEGRATORS[integrator].implicit else 1.0
    longest = within = control_dt / (margin * least)
    for angles in (home, 0.0 * home, *(home + others)):
        q = np.zeros(arm.n)
        q[joints] = angles
        longest = step_limits.largest_step(model, q, integrator, longest)
    return least if longest == within else math.ceil(control_dt / (SAFE * longest))
