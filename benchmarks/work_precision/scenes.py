"""Scenes of the work-precision charts: an arm, a motion, and the true motion of its tip.

The truths are stored in tests/reference/: for S1 and S3 a geometrically nonlinear beam, for the
others links of many foreshortened segments, computed by `python -m benchmarks.work_precision
--truth`. No scene is damped: a damping ratio is a different force for every set of modes.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from benchmarks.accuracy.model_choice import S1, SpinUp
from benchmarks.arms import undamped
from benchmarks.output import REFERENCE
from dynamics import ARMS, Arm, Joint, JointMotion, Link, Mode, Model
from dynamics.accuracy.fidelity import Fidelity, everything
from dynamics.accuracy.scene import bang_bang, release
from dynamics.types import Array
from flexarm_env.registration import SCENES
from flexarm_env.task.scales import scales

HEAVY = 1e8  # [kg m^2] a rotor that no link can move: its joint turns as prescribed
FEWEST = 12  # least number of output times of a run with long steps
GOOD = "Good to"  # in a truth's file, the error over the reach follows this text


@dataclass(frozen=True, kw_only=True)
class Level:
    """Fidelity of a model, equal for all links: modes, foreshortening, segments, lumped masses."""

    modes: int  # per link (or segment) and direction
    foreshortening: bool = False
    segments: int = 1
    lumped: bool = False

    def arm(self, arm: Arm) -> Arm:
        """The arm at this fidelity; segments have polynomial shapes, whole links the arm's own."""
        fidelity = Fidelity(
            counts=everything(arm, self.modes, 0),
            segments=(self.segments if self.modes else 1,) * arm.n_joint,
            foreshortening=self.foreshortening,
            polynomial=self.segments > 1 or self.lumped,
            lumped=self.lumped,
        )
        return fidelity.arm(arm)

    @property
    def kind(self) -> str:
        """The fidelity without the number of modes, in words."""
        if self.modes == 0:
            return "rigid"
        cut = f"{self.segments} segments, " if self.segments > 1 else ""
        lumped = "lumped, " if self.lumped else ""
        return cut + lumped + ("foreshortened" if self.foreshortening else "linear")

    def __str__(self) -> str:
        if self.modes == 0:
            return self.kind
        return f"{self.modes} {'mode' if self.modes == 1 else 'modes'}, {self.kind}"


WHOLE = (
    Level(modes=0),
    *(Level(modes=m) for m in (1, 2, 3, 4)),
    *(Level(modes=m, foreshortening=True) for m in (1, 2, 3)),
)
CUT = tuple(Level(modes=2, segments=k, foreshortening=f) for k in (2, 4) for f in (False, True))
DEEP = tuple(Level(modes=3, segments=k, foreshortening=True) for k in (2, 4))  # for one link
_FINER = tuple(Level(modes=3, segments=k, foreshortening=True) for k in (4, 8))
SHORT = (  # for an arm of six links
    *(Level(modes=m) for m in (0, 1, 2, 3)),
    *(Level(modes=m, foreshortening=True) for m in (1, 2)),
    Level(modes=2, foreshortening=True, lumped=True),
)


@dataclass(frozen=True, kw_only=True)
class Setting:
    """A scene, and the models that are measured on it."""

    name: str  # as in the truth's file name
    title: str
    arm: Arm  # undamped, with the environment's modes
    motion: JointMotion
    period: float  # [s] between output times; the torque jumps only at output times
    constant_torque: bool = True  # between output times
    levels: tuple[Level, ...] = (*WHOLE, *CUT)
    # Two models: the tip of the second is the truth, its distance from the first the error. None
    # if a geometrically nonlinear beam is the truth.
    refined: tuple[Level, ...] = ()

    @property
    def _knots(self) -> list[int]:
        """Indices of the output times at which the torque jumps, including both ends."""
        return [round(t / self.period) for t in self.motion.knots]

    @property
    def times(self) -> Array:
        """(N,) [s] output times."""
        return np.array([self.period * k for k in range(self._knots[-1] + 1)])

    @property
    def file(self) -> Path:
        """File of the truth."""
        kind = "segments" if self.refined else "nonlinear_beam"
        return REFERENCE / f"{self.name}_{kind}.csv"

    @cached_property
    def floor(self) -> float:
        """Error of the truth over the reach [-]."""
        return float(self.file.read_text().split(GOOD)[1].split()[0])

    @cached_property
    def truth(self) -> Array:
        """(N, 3) [m] tip at the output times."""
        table = np.loadtxt(self.file, delimiter=",", comments=("#", "t"))
        known, wanted = table[:, 0], self.times
        if known.size != wanted.size or np.abs(known - wanted).max() > 1e-9:
            raise ValueError(f"{self.file.name} does not have the output times of {self.title!r}.")
        if not self.refined:
            table[:, 3] = 0.0  # the column holds the hub's angle; these beams move in a plane
        return table[:, 1:]

    def start(self, model: Model) -> tuple[Array, Array]:
        """(n,) coordinates and (n,) velocities at the start, with straight links."""
        q, v = np.zeros(model.n), np.zeros(model.n)
        joints = list(model.arm.joint_index)
        q[joints], v[joints] = self.motion.joint_angles, self.motion.joint_rates
        return q, v

    @property
    def strides(self) -> tuple[int, ...]:
        """Numbers of output times that one step may span without crossing a jump, descending."""
        common = math.gcd(*self._knots)
        fit = [k for k in range(1, common + 1) if common % k == 0]
        return tuple(k for k in reversed(fit) if self._knots[-1] // k >= FEWEST)


def _clamped(arm: Arm, foreshortening: bool = False) -> Arm:
    """The arm with two clamped-tip-mass modes per link, as SLIM has."""
    modes = tuple(Mode(kind="clamped-tip-mass", index=k, direction="y") for k in (1, 2))
    links = tuple(replace(link, modes=modes) for link in arm.links)
    return replace(arm, links=links, foreshortening=foreshortening)


def _of_env(
    family: str,
    title: str,
    pulse: int,
    count: int,
    levels: tuple[Level, ...] = (*WHOLE, *CUT),
    refined: tuple[Level, ...] = _FINER,
) -> Setting:
    """Scene of a family: full torque of all joints for `pulse` control steps, reversed, then off.

    The motion has `count` control steps and starts at the home posture, with the environment's
    torque limits. The pulse is half a period of the first joint-free mode, as nearly as control
    steps and halves of them allow.
    """
    preset, control_dt, _ = SCENES[family]
    arm = undamped(ARMS[preset])
    found = scales(ARMS[preset])
    motion = bang_bang(found.torque_limit, pulse * control_dt, count * control_dt)
    return Setting(
        name=preset,
        title=title,
        arm=arm,
        motion=replace(motion, joint_angles=found.home),
        period=control_dt,
        levels=levels,
        refined=refined,
    )


_SPUN = Link(length=10.0, rho_A=1.2, EIz=1.4e4, modes=(), joint=Joint(rotor_inertia=HEAVY))
SETTINGS = {
    setting.name: setting
    for setting in (
        _of_env("OneLink", "OneLink: SLIM, bang-bang", 4, 48, (*WHOLE, *CUT, *DEEP)),
        _of_env("TwoLink", "TwoLink: after De Luca and Siciliano, bang-bang", 8, 48),
        _of_env("SixLink", "SixLink: spatial, bang-bang", 4, 40, SHORT, DEEP),
        Setting(
            name="S1", title="S1: one link, bang-bang", arm=_clamped(S1), period=0.01,
            motion=bang_bang((0.5,), pulse=0.25, t_end=2.0), levels=(*WHOLE, *CUT, *DEEP),
        ),
        Setting(
            name="S3", title="S3: spin-up of a soft beam", constant_torque=False, period=0.05,
            arm=_clamped(Arm(links=(_SPUN,)), foreshortening=True), levels=(*WHOLE, *CUT, *DEEP),
            motion=JointMotion(
                joint_angles=(0.0,), joint_rates=(0.0,), t_end=20.0, torque=SpinUp(HEAVY + 400.0)
            ),
        ),
        Setting(
            name="korayem-two-link", title="Korayem's two links, falling", period=0.02,
            arm=undamped(ARMS["korayem-two-link"]), refined=_FINER,
            motion=release((-0.5 * math.pi, math.pi / 36.0), t_end=1.5),
        ),
    )
}  # fmt: skip
