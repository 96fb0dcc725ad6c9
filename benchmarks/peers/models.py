"""Our models on the peers' scenes, and their runs."""

import time
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import groupby

import numpy as np

from benchmarks.peers.lines import Run
from benchmarks.peers.scenes import PeerScene
from dynamics import Arm, Mode, Model, Stepper, compile_arm
from dynamics.description.arm import FOURTH_ORDER
from dynamics.integrators.table import INTEGRATORS


@dataclass(frozen=True)
class Shapes:
    """Mode shapes of an arm: their kind and number per link."""

    kinds: tuple[str, ...]
    counts: tuple[int, ...]
    foreshortening: bool
    segments: int = 1
    axial: int = 0  # polynomials along the axis, per link or segment

    def __str__(self) -> str:
        modes = ", ".join(f"{n} {kind}" for kind, n in zip(self.kinds, self.counts, strict=True))
        along = f" and {self.axial} axial-poly" if self.axial else ""
        cut = f" in each of {self.segments} segments" if self.segments > 1 else ""
        return f"{modes}{along}{cut}{', foreshortened' if self.foreshortening else ''}"

    def arm(self, scene: PeerScene) -> Arm:
        """The scene's arm with these modes."""
        along = [Mode(kind="axial-poly", index=k + 1, direction="axial") for k in range(self.axial)]
        links = tuple(
            replace(
                link,
                segments=self.segments,
                EA=scene.axial if along else None,
                modes=(
                    *(Mode(kind=kind, index=k + 1, direction="y") for k in range(count)),
                    *along,
                ),
            )
            for link, kind, count in zip(scene.arm.links, self.kinds, self.counts, strict=True)
        )
        return replace(scene.arm, links=links, foreshortening=self.foreshortening and FOURTH_ORDER)

    @property
    def methods(self) -> tuple[str, ...]:
        """Methods worth a run: the others are seldom the cheapest, or compile slowly."""
        if self.segments > 1 or self.axial:
            return FAST
        return tuple(INTEGRATORS) if len(self.kinds) == 1 else (*FAST, "rk4", "numerov")


FAST = ("midpoint", "generalized-alpha", "exponential")  # the modes of segments are fast


def _cut(*sizes: tuple[int, int], links: int = 1, axial: int = 0) -> tuple[Shapes, ...]:
    """Foreshortened links with so many polynomials in each of so many segments."""
    return tuple(Shapes(("poly",) * links, (n,) * links, True, k, axial) for n, k in sizes)


OUR_SHAPES = {  # the first two make the quick form
    "S1": (
        Shapes(("clamped-tip-mass",), (2,), False),
        Shapes(("clamped-tip-mass",), (3,), True),
        *(Shapes(("clamped-tip-mass",), (n,), f) for n, f in ((1, False), (3, False), (4, False))),
        *(Shapes(("clamped-tip-mass",), (n,), True) for n in (2, 4)),
        *(Shapes(("clamped-free",), (n,), f) for n, f in ((1, False), (4, False), (3, True))),
        *_cut((2, 2), (2, 4), (2, 8), (3, 4), (3, 6), (3, 8), (3, 16)),
    ),
    "S3": (
        *(Shapes(("clamped-free",), (n,), True) for n in (1, 2, 3, 4)),
        *_cut((2, 2), (2, 4), (2, 8)),
        *_cut((2, 4), (2, 6), (2, 8), (2, 12), (2, 16), axial=1),
    ),
    "korayem": (
        Shapes(("pinned-free", "pinned-free"), (2, 2), False),
        Shapes(("pinned-free", "clamped-free"), (2, 2), False),
        *(Shapes(("pinned-free", "pinned-free"), (n, n), True) for n in (2, 3, 4)),
        Shapes(("pinned-free", "pinned-free"), (3, 2), False),
        *(
            Shapes((inner, outer), (1, 1), False)
            for inner in ("pinned-free", "clamped-free")
            for outer in ("pinned-free", "clamped-free")
        ),
        *_cut((2, 8), (4, 3), (3, 6), (3, 8), links=2),
    ),
}


@cache
def compiled(arm: Arm) -> Model:
    """The arm compiled, once per arm."""
    return compile_arm(arm)


def our_run(
    scene: PeerScene,
    model: Model,
    integrator: str,
    rate: Fraction,
    record: bool,
    n_env: int = 1,
    most: int | None = None,
) -> Run:
    """Tips and processor time of a batch of equal environments; each call has constant torque.

    Only the first `most` steps are run.
    """
    stepper = Stepper(model, n_env, dt=scene.step(rate), substeps=1, integrator=integrator)
    stepper.advance()  # its first call finds the compiled code, which takes as long as many steps
    stepper.q[:], stepper.v[:], stepper.status[:] = 0.0, 0.0, 0
    stepper.q[:, list(model.arm.joint_index)] = scene.motion.joint_angles
    torques = scene.torques(rate)[:most]
    ends = np.arange(torques.size) // rate.numerator if record else np.zeros(torques.size)
    calls = [
        (torque, len(list(group)))
        for (torque, _), group in groupby(zip(torques.tolist(), ends.tolist(), strict=True))
    ]
    tips, done, where = [], 0, model.measurements["tip"]
    begin = time.process_time()
    for torque, count in calls:
        stepper.torque[:, 0], stepper.substeps = torque, count
        stepper.advance()
        if record:
            done += count
            if done % rate.numerator == 0:
                tip = stepper.measured[0, where][:2]
                tips.append(np.full(2, np.nan) if stepper.status[0] else tip.copy())
    return np.array(tips).reshape(-1, 2), time.process_time() - begin
