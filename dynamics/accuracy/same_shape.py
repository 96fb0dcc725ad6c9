"""The deflection of one model of an arm in the coordinates of another."""

import numpy as np

from dynamics.description.arm import FOURTH_ORDER, Arm
from dynamics.description.mode_shapes import BENDING, shape
from dynamics.formulations.link_constants import parts
from dynamics.types import Array

POINTS = 120  # along a link, at which shapes are compared
FIELDS = (*BENDING, "x", "axial")  # angles of bending, twist, stretch over the length
ROUNDS = 6  # of Gauss and Newton, which converge to round-off
STEP = 1e-4  # [s] of the central difference that gives the rates


def transferred(q: Array, v: Array, source: Arm, target: Arm) -> tuple[Array, Array]:
    """(N, n) coordinates and rates of another model of the same arm, whose links bend alike.

    Links bend alike if their sections have the same angles, fitted by least squares.
    """
    if source == target:
        return q.copy(), v.copy()
    moved, turned = np.zeros((len(q), target.n)), np.zeros((len(q), target.n))
    places = {name: k for k, name in enumerate(source.names)}
    for k, name in enumerate(target.names):
        if not name.startswith("d"):
            moved[:, k], turned[:, k] = q[:, places[name]], v[:, places[name]]
    for i in range(len(source.links)):
        own, other = _modal(source, i), _modal(target, i)
        if own and other:
            given, bent = Bent(source, i), Bent(target, i)
            delta, step = q[:, own], STEP * v[:, own]
            fits = [bent.fitted(given.angles(delta + sign * step)) for sign in (-1.0, 0.0, 1.0)]
            moved[:, other], turned[:, other] = fits[1], (fits[2] - fits[0]) / (2.0 * STEP)
            if any(given.root) or any(bent.root):  # the roots point alike
                joint = target.names.index(f"q{i + 1}")
                for new, old in ((moved, q), (turned, v)):
                    new[:, joint] += old[:, own] @ given.root - new[:, other] @ bent.root
    return moved, turned


class Bent:
    """Angles of a link's sections against its root, from the amplitudes of all segments' modes.

    `root` (m,) are the angles of the root itself per amplitude; zero but for pinned-free modes.
    """

    def __init__(self, arm: Arm, i: int) -> None:
        link = arm.links[i]
        self.sines = arm.foreshortening == FOURTH_ORDER and arm.rotation == "exp"
        x = np.linspace(0.0, link.length, POINTS + 1)[1:]
        begins = link.length / link.segments * np.arange(link.segments)
        self.slopes = np.zeros(
            (link.segments, len(FIELDS), POINTS, link.segments * len(link.modes))
        )
        self.root = np.zeros(self.slopes.shape[-1])
        for k, part in enumerate(parts(link)):
            local = np.clip(x - begins[k], 0.0, part.length)
            for j, mode in enumerate(part.modes):
                s = shape(mode, part.beam)
                column = k * len(part.modes) + j
                if mode.kind == "pinned-free":
                    self.root[column] = s.slope(0.0)
                rows = s.slope(local) if mode.direction in BENDING else s.value(local)
                rows = rows / (link.length if mode.direction == "axial" else 1.0)
                rows = rows - self.root[column]
                inside = np.where(x > begins[k], rows, 0.0)
                self.slopes[k, FIELDS.index(mode.direction), :, column] = inside

    def angles(self, delta: Array) -> Array:
        """(N, fields * points) at amplitudes (N, m); slopes of a segment are sines."""
        slopes = np.einsum("kfxm,nm->nkfx", self.slopes, delta)
        if self.sines:
            slopes[:, :, : len(BENDING)] = np.arcsin(slopes[:, :, : len(BENDING)])
        result: Array = slopes.sum(axis=1).reshape(len(delta), -1)
        return result

    def fitted(self, angles: Array) -> Array:
        """(N, m) amplitudes whose angles are nearest to those given."""
        linear = self.slopes.sum(axis=0).reshape(-1, self.slopes.shape[-1])
        back = np.linalg.pinv(linear).T
        delta = angles @ back
        for _ in range(ROUNDS):
            delta = delta + (angles - self.angles(delta)) @ back
        return delta


def _modal(arm: Arm, i: int) -> list[int]:
    """Columns of a link's modal amplitudes."""
    return [k for k, name in enumerate(arm.names) if name.startswith(f"d{i + 1}_")]
