"""Pictures of the arm, drawn without a display: bent, with exaggerated bending, and straight.

The view of a planar arm is from above, that of a spatial arm is oblique, with shadows on the floor.
A floating base is drawn as a square of its mass and inertia.
"""

import math
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dynamics.description.deflection import deflection, shortening
from dynamics.description.rotations import from_rotation_vector, rotation_matrix
from dynamics.formulations.link_constants import chain_constants, parts
from dynamics.types import Array
from flexarm_env.core import Core
from flexarm_env.task.observations import is_level

SIZE = (640, 480)  # [px]
FINE = 2  # supersampling factor, for smooth edges
EXAGGERATION = 5.0  # factor on deflections
POINTS = 10  # along a link; more would be shorter than the line is wide
TRAIL = 150  # control steps
STRIP = 3.0  # [s] of deflection in the strip
GROUND = (250, 250, 248)
INK = (38, 50, 56)
FAINT = (176, 190, 197)
GHOST = (200, 211, 217)  # the rigid arm
SHADOW = (226, 228, 226)
GRID = (232, 236, 238)
SOLID = (207, 216, 220)
STEEL = (38, 70, 120)
ORANGE = (230, 126, 34)
GREEN = (39, 144, 96)
VIEW = np.array([[0.80, -0.60, 0.0], [0.24, 0.32, 0.9165]])  # (2, 3) oblique, z upward
STRIP_HEIGHT = 64  # [px]
SIDE, TOP = 40, 52  # [px] margins of a close-up; texts are above it


class Renderer:
    """Draws environments of a core; records trail and deflection of the first one's tip.

    Parameters
    ----------
    height : [px] of the pictures, which have the form of SIZE; drawn at this size, not resized.
    """

    def __init__(self, core: Core, height: int = SIZE[1]) -> None:
        arm = core.arm
        self.fine = FINE * height / SIZE[1]  # drawn pixels per pixel of SIZE
        self.canvas = (round(SIZE[0] * height / SIZE[1]) * FINE, height * FINE)
        self.planar = is_level(arm)
        self.view = np.eye(3)[:2] if self.planar else VIEW
        self.constants = chain_constants(arm)
        room = SIZE[1] - STRIP_HEIGHT - 34  # [px] above the legend and the strip
        self.scale = room / ((1.9 if self.planar else 1.6) * arm.reach)  # [px/m]
        base = 0.24 if self.planar else 0.4  # [-] of the width: home postures point to the right
        base = 0.5 if arm.base.n else base  # but not from a base at any angle
        self.centre = np.array([base * SIZE[0], (0.5 if self.planar else 0.64) * room + 4])
        self.place = np.array(arm.base.position)  # [m] of the base, as described
        self.centre -= self.place @ self.view.T * self.scale * (1.0, -1.0)
        self.trail: list[Array] = []
        self.bent: list[float] = []  # [m] elastic tip displacement, signed where planar
        self._window: Any = None
        self.follow(core)
        self._fonts = {size: ImageFont.load_default(size=size * self.fine) for size in (12, 14)}

    def close_up(self, points: Array) -> None:
        """Choose scale and place so that points (., 3) [m], the base and their feet fill the view.

        The picture never gets smaller than it is.
        """
        shown = np.concatenate([points, points * (1.0, 1.0, 0.0), np.zeros((1, 3))])
        flat = shown @ self.view.T * (1.0, -1.0)
        low, high = flat.min(axis=0), flat.max(axis=0)
        corner = np.array([SIDE, TOP])  # [px]
        free = np.array([SIZE[0] - SIDE, SIZE[1] - STRIP_HEIGHT - 54.0]) - corner
        scale = float((free / np.maximum(high - low, 1e-9)).min())
        if scale > self.scale:
            self.scale = scale
            self.centre = corner + free / 2 - scale * (low + high) / 2

    def follow(self, core: Core, row: int = 0) -> None:
        """Record the present tip of environment `row`, alone at the start of its episode."""
        if not core.elapsed(row):
            self.trail.clear()
            self.bent.clear()
        tip = core.model.tip(core.q[row])
        rigid = core.model.tip(_straight(core, row))
        self.trail.append(tip.copy())
        shift = tip - rigid
        sign = 1.0
        if self.planar:
            out = rigid[:2] - core.q[row, :2] if core.arm.base.n else rigid
            sign = math.copysign(1.0, out[0] * shift[1] - out[1] * shift[0])
        self.bent.append(sign * float(np.linalg.norm(shift)))
        del self.trail[:-TRAIL]

    # ---- geometry ----------------------------------------------------------------------------

    def shapes(self, core: Core, q: Array, factor: float) -> list[Array]:
        """(., 3) [m] centre line of every link in the world frame, deflections times `factor`.

        It begins at the link's joint and ends at the next one, beyond offset roots and brackets.
        R_i = R_{i-1} E_{i-1} F_i Rz(q_i), with the rotation E of a bent end. A parallel drive
        turns relative to the base frame of the joint before.
        """
        lines: list[Array] = []
        R, end, E = *_base_pose(core, q), np.eye(3)
        base = R  # orientation of the base frame of the joint before
        at = core.arm.base.n
        for link, constants in zip(core.arm.links, self.constants, strict=True):
            end = end + R @ E @ np.array(link.joint.offset)
            if lines and any(link.joint.offset):
                lines[-1] = np.vstack([lines[-1], end])
            joints = link.joint.moves + link.joint.elastic  # the rotor, the twist of its spring
            angle = sum(q[at : at + joints].tolist())
            c, s = math.cos(angle), math.sin(angle)
            if link.joint.parallel:
                R, E = base, np.eye(3)
            E = E @ np.array(link.joint.rotation)
            base = R @ E
            E = E @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            at += joints
            line = [end[None]] if any(link.joint.root) else []
            end = end + R @ E @ np.array(link.joint.root)
            for part, constant in zip(parts(link), constants[-link.segments :], strict=True):
                delta = factor * q[at : at + len(part.modes)]
                at += len(part.modes)
                x = np.linspace(0.0, part.length, POINTS)
                shape = np.stack([x, 0.0 * x, 0.0 * x], axis=1)
                theta = np.zeros(3)
                if part.modes:
                    shape += deflection(part, delta, x)
                    if core.arm.foreshortening:
                        shape[:, 0] += shortening(part, delta, x)
                    theta = np.array(constant.tip_theta).T @ delta
                    if constant.sines:  # slopes are sines, as in formulations/kinematics.py
                        square = theta[1:] @ theta[1:]
                        theta[1:] *= 1.0 + square * (1.0 / 6.0 + 3.0 / 40.0 * square)
                R = R @ E
                line.append(end + shape @ R.T)
                end, E = line[-1][-1], _rotation(theta)
            lines.append(np.concatenate(line))
        return lines

    def forms(self, core: Core) -> tuple[Array, Array, Array]:
        """Centre lines (links, points, 3), ends of straight links (links, 2, 3), target (3,) [m].

        Those of the first environment.
        """
        bent = self.shapes(core, core.q[0], 1.0)
        straight = self.shapes(core, _straight(core, 0), 0.0)
        beams = [self._beam(core, k, line) for k, line in enumerate(bent)]
        rigid = [self._beam(core, k, line) for k, line in enumerate(straight)]
        even = [_evenly(line, still) for line, still in zip(beams, rigid, strict=True)]
        ends = [line[[0, -1]] for line in rigid]
        return np.array(even), np.array(ends), core.goal(0).copy()

    def _beam(self, core: Core, k: int, line: Array) -> Array:
        """The line of link k without its offset root and the bracket of the next joint."""
        links = core.arm.links
        bracket = k + 1 < len(links) and any(links[k + 1].joint.offset)
        return line[int(any(links[k].joint.root)) : len(line) - bracket]

    def pixels(self, points: Array) -> list[tuple[float, float]]:
        """Pixels of world points [m] on the supersampled canvas."""
        flat = np.atleast_2d(points) @ self.view.T * self.scale * (1.0, -1.0) + self.centre
        return [(float(x), float(y)) for x, y in flat * self.fine]

    # ---- drawing -----------------------------------------------------------------------------

    def draw(self, core: Core, row: int = 0) -> NDArray[np.uint8]:
        """(H, W, 3) picture of environment `row`."""
        image = Image.new("RGB", self.canvas, GROUND)
        pen = ImageDraw.Draw(image)
        self._draw_floor(pen, core.arm.reach)
        q = core.q[row]
        goal = core.goal(row)
        if row == 0 and len(self.trail) > 1:
            self._draw_trail(pen)
        straight = _straight(core, row)
        bent = self.shapes(core, q, 1.0)
        if not self.planar:
            self._draw_shadow(pen, bent, goal)
        self._draw_base(pen, core, q)
        self._draw_arm(pen, self.shapes(core, straight, 0.0), GHOST, 15)
        self._draw_arm(pen, self.shapes(core, q, EXAGGERATION), ORANGE, 3)
        self._draw_arm(pen, bent, STEEL, 7, body=True)
        self._draw_target(pen, goal, core.arm.reach)
        self._draw_text(pen, core, row)
        if row == 0:
            self._draw_strip(pen, core)
        return np.asarray(image.reduce(FINE), dtype=np.uint8)

    def _draw_floor(self, pen: ImageDraw.ImageDraw, reach: float) -> None:
        step = 10.0 ** math.floor(math.log10(reach))
        step = step / 2 if reach / step < 3 else step
        count = int(reach // step)
        angles = np.linspace(0.0, 2.0 * math.pi, 121)
        ring = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
        for k in range(1, count + 1):
            circle = self.place + k * step * ring
            pen.line(self.pixels(circle), fill=GRID, width=round(self.fine))
        for axis in np.eye(3)[: 2 if self.planar else 3]:
            ends = np.array([-axis if axis[2] == 0.0 else 0.0 * axis, axis]) * reach
            pen.line(self.pixels(self.place + ends), fill=GRID, width=round(self.fine))

    def _draw_shadow(self, pen: ImageDraw.ImageDraw, lines: list[Array], goal: Array) -> None:
        """Shadow of the links on the floor, and plumb lines of tip and target."""
        for line in lines:
            pen.line(self.pixels(line * (1.0, 1.0, 0.0)), SHADOW, round(7 * self.fine), "curve")
        for point, colour in ((lines[-1][-1], FAINT), (goal, GREEN)):
            foot = point * (1.0, 1.0, 0.0)
            pen.line(self.pixels(np.array([point, foot])), colour, round(self.fine))
            _disc(pen, self.pixels(foot)[0], 2.0 * self.fine, colour)

    def _draw_base(self, pen: ImageDraw.ImageDraw, core: Core, q: Array) -> None:
        """The square that has a floating base's mass and inertia; the post of a fixed one."""
        base = core.arm.base
        R, place = _base_pose(core, q)
        if not base.n:
            post = np.array([place, core.arm.links[0].joint.offset])
            pen.line(self.pixels(post), fill=FAINT, width=round(7 * self.fine))
            return
        half = 0.5 * math.sqrt(6.0 * base.inertia[2][2] / base.mass)  # [m]
        corners = half * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) + base.com
        pen.polygon(
            self.pixels(place + corners @ R.T),
            fill=SOLID,
            outline=FAINT,
            width=round(2 * self.fine),
        )

    def _draw_arm(
        self,
        pen: ImageDraw.ImageDraw,
        lines: list[Array],
        colour: tuple[int, int, int],
        width: int,
        body: bool = False,
    ) -> None:
        for k, line in enumerate(lines):
            thick = (
                width * self.fine * (1.0 - 0.45 * k / max(1, len(lines)))
                if body
                else width * self.fine
            )
            pen.line(self.pixels(line), fill=colour, width=round(thick), joint="curve")
        if not body:
            return
        x, y = self.pixels(lines[0][0])[0]
        size = 15 * self.fine
        pen.rounded_rectangle((x - size, y - size, x + size, y + size), 5 * self.fine, fill=FAINT)
        for k, line in enumerate(lines):
            radius = (9.0 if k == 0 else 6.5 - 2.5 * k / len(lines)) * self.fine
            _disc(pen, self.pixels(line[0])[0], radius, INK)
            _disc(pen, self.pixels(line[0])[0], 0.45 * radius, GROUND)
        _disc(pen, self.pixels(lines[-1][-1])[0], 4.5 * self.fine, INK)

    def _draw_trail(self, pen: ImageDraw.ImageDraw) -> None:
        points = self.pixels(np.array(self.trail))
        for k, (a, b) in enumerate(pairwise(points)):
            fade = (k + 1 + TRAIL - len(points)) / TRAIL
            colour = tuple(
                round(g + (s - g) * 0.6 * fade) for g, s in zip(GROUND, STEEL, strict=True)
            )
            pen.line([a, b], fill=colour, width=round(2 * self.fine))

    def _draw_target(self, pen: ImageDraw.ImageDraw, goal: Array, reach: float) -> None:
        """A cross in a ring; the ring is the settled band, 2 % of the reach."""
        x, y = self.pixels(goal)[0]
        radius = max(0.02 * reach * self.scale, 5.0) * self.fine
        pen.ellipse(
            (x - radius, y - radius, x + radius, y + radius),
            outline=GREEN,
            width=round(2 * self.fine),
        )
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            start, stop = 0.55 * radius, radius + 5 * self.fine
            pen.line(
                (x + dx * start, y + dy * start, x + dx * stop, y + dy * stop),
                GREEN,
                round(2 * self.fine),
            )

    def _draw_text(self, pen: ImageDraw.ImageDraw, core: Core, row: int) -> None:
        error = float(np.linalg.norm(core.goal(row) - core.model.tip(core.q[row])))
        time = core.elapsed(row) * core.control_dt
        unit, factor = ("mm", 1e3) if core.arm.reach < 10.0 else ("m", 1.0)
        right = (SIZE[0] - 16) * self.fine
        large, small = self._fonts[14], self._fonts[12]
        pen.text((right, 12 * self.fine), f"t = {time:5.2f} s", fill=INK, font=large, anchor="ra")
        text = f"tip error {factor * error:6.1f} {unit}"
        colour = GREEN if error < 0.02 * core.arm.reach else INK
        pen.text((right, 32 * self.fine), text, fill=colour, font=large, anchor="ra")
        y = (SIZE[1] - STRIP_HEIGHT - 22) * self.fine
        for x, colour, word in (
            (16, STEEL, "arm"),
            (66, ORANGE, f"bending x {EXAGGERATION:.0f}"),
            (164, GHOST, "rigid"),
            (218, GREEN, "target"),
        ):
            pen.line(
                (x * self.fine, y, (x + 14) * self.fine, y), fill=colour, width=round(4 * self.fine)
            )
            pen.text(((x + 19) * self.fine, y), word, fill=INK, font=small, anchor="lm")

    def _draw_strip(self, pen: ImageDraw.ImageDraw, core: Core) -> None:
        """Plot the elastic tip displacement of the last seconds."""
        left, right = 16 * self.fine, (SIZE[0] - 16) * self.fine
        bottom = (SIZE[1] - 8) * self.fine
        top = bottom - STRIP_HEIGHT * self.fine
        middle = (top + bottom) / 2
        pen.rectangle(
            (left, top, right, bottom), fill=(255, 255, 255), outline=GRID, width=round(self.fine)
        )
        pen.line((left, middle, right, middle), fill=GRID, width=round(self.fine))
        count = max(2, round(max(STRIP, 4.0 * core.move_time) / core.control_dt))
        bent = self.bent[-count:]
        if len(bent) > 1:
            full = max(0.02 * core.arm.reach, 1.1 * max(map(abs, self.bent)))
            x = left + (right - left) * np.arange(len(bent)) / (count - 1)
            y = middle - np.array(bent) / full * (bottom - top) / 2
            points = list(zip(x.tolist(), y.tolist(), strict=True))
            pen.line(points, fill=ORANGE, width=round(2 * self.fine), joint="curve")
            _disc(pen, points[-1], 3.5 * self.fine, ORANGE)
        text = f"tip deflection {1e3 * abs(bent[-1]) if bent else 0.0:6.1f} mm"
        pen.text((right, top - 14 * self.fine), text, fill=INK, font=self._fonts[12], anchor="rm")

    # ---- window ------------------------------------------------------------------------------

    def show(self, picture: NDArray[np.uint8], seconds: float) -> None:
        """Show a picture in a window for some seconds; without a display, draw it unseen."""
        import matplotlib.pyplot as plt

        if self._window is None:
            figure = plt.figure("flexarm", figsize=(SIZE[0] / 100, SIZE[1] / 100), dpi=100)
            self._window = figure.figimage(picture)
            figure.show() if plt.get_backend().lower() != "agg" else None
        self._window.set_data(picture)
        figure = self._window.figure
        figure.canvas.draw_idle()
        if plt.get_backend().lower() != "agg":
            figure.canvas.start_event_loop(seconds)

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            import matplotlib.pyplot as plt

            plt.close(self._window.figure)
            self._window = None


def _base_pose(core: Core, q: Array) -> tuple[Array, Array]:
    """Orientation (3, 3) and position (3,) [m] of the base in the world at coordinates q (n,)."""
    if not core.arm.base.n:
        return np.eye(3), np.zeros(3)
    return _rotation(np.array([0.0, 0.0, q[2]])), np.array([*q[:2], 0.0])


def _straight(core: Core, row: int) -> Array:
    """(n,) coordinates of environment `row` with straight links."""
    q, base = core.q[row], core.arm.base.n
    straight = core.model.rigid(q)
    straight[:base] = q[:base]
    return straight


def _evenly(line: Array, straight: Array) -> Array:
    """(POINTS, 3) [m] of a line, at even distances along the straight link."""
    along = np.linalg.norm(straight - straight[0], axis=1)
    places = np.linspace(0.0, along[-1], POINTS)
    return np.stack([np.interp(places, along, values) for values in line.T], axis=1)


def _rotation(theta: Array) -> Array:
    """Rotation matrix exp(theta~) of a rotation vector [rad]."""
    return np.array(rotation_matrix(from_rotation_vector(theta)))


def _disc(
    pen: ImageDraw.ImageDraw,
    centre: tuple[float, float],
    radius: float,
    colour: tuple[int, int, int],
) -> None:
    x, y = centre
    pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)
