"""Pictures without a display: learning curves, tip error and root curvature, films of the arm."""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image, ImageDraw, ImageFont

from agents.files import atomic_write
from agents.metrics import Recording, make_batch, progress, record
from agents.policy import Controller
from dynamics.types import AnyArray
from flexarm_env.rendering import Renderer
from flexarm_env.task.tasks import SETTLED_BAND

COLOURS = (  # colour-blind safe
    "#0072b2", "#d55e00", "#7f7f7f", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000",
)  # fmt: skip
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*", "p")
DASHES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (4, 1, 1, 1, 1, 1)))
PICTURE_COLOURS = 64
LARGEST_PICTURE = 140_000  # [bytes]
LINE = 95  # letters of a title
GIF_SECONDS_PER_FRAME = 0.04
GIF_HEIGHT = 300  # [px] height of the arm's picture
FREQUENT = 8  # most frequent colours that a GIF keeps exactly
STRIP_HEIGHT = 130  # [px] height of each strip below it


def new_figure(width: float, height: float, dpi: int = 130) -> Figure:
    """A figure without a window and without pyplot's global state."""
    figure = Figure(figsize=(width, height), dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path, dpi: float | None = None) -> None:
    """Write the figure as PNG of few colours, with fewer pixels where it would be too large."""
    dpi = dpi or figure.dpi
    while len(png := _png(figure, dpi)) > LARGEST_PICTURE:
        dpi *= 0.9
    with atomic_write(path) as temporary:
        temporary.write_bytes(png)


def _png(figure: Figure, dpi: float) -> bytes:
    drawn, written = BytesIO(), BytesIO()
    figure.savefig(drawn, dpi=dpi, format="png")
    few_colours(Image.open(drawn)).save(written, "PNG", optimize=True)
    return written.getvalue()


def few_colours(picture: Image.Image) -> Image.Image:
    """The picture with a palette: its most frequent colours, which lines have, and means of all."""
    picture, half = picture.convert("RGB"), PICTURE_COLOURS // 2
    means = picture.quantize(half, dither=Image.Dither.NONE)
    levels = (palette_of(picture, means, half).getpalette() or [])[: 3 * PICTURE_COLOURS]
    # Pillow's own choice of the nearest is a few levels off, which greys a white ground.
    of_palette = np.reshape(levels, (-1, 3)).astype(float)
    numbers = np.asarray(picture, np.int64) @ (1 << 16, 1 << 8, 1)
    unique, places = np.unique(numbers, return_inverse=True)
    colours = np.stack([unique >> 16, unique >> 8 & 255, unique & 255], axis=-1).astype(float)
    distances = np.sum(of_palette**2, axis=-1) - 2.0 * colours @ of_palette.T
    nearest = np.argmin(distances, axis=-1)
    return _framed(nearest[places.reshape(numbers.shape)], levels)


def look(k: int) -> dict[str, Any]:
    """Colour, marker and dashes of the k-th of several lines."""
    return {
        "color": COLOURS[k % len(COLOURS)],
        "marker": MARKERS[k % len(MARKERS)],
        "linestyle": DASHES[k % len(DASHES)],
        "linewidth": 1.4,
        "markersize": 5,
    }


def tidy(axes: Any) -> None:
    """Hide the upper and right spines, and lighten the grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, linewidth=0.6)


def plot_learning_curve(
    path: Path, runs: Mapping[str, Sequence[Mapping[str, Any]]], title: str
) -> None:
    """Plot mean episode return and settled share over steps, one line per run."""
    figure = new_figure(8.0, 3.2)
    columns = (("return", "episode return"), ("settled", "episodes ending on target [%]"))
    for axes, (key, label) in zip(figure.subplots(1, 2), columns, strict=True):
        for i, (name, rows) in enumerate(runs.items()):
            points = [(r["steps"], r[key]) for r in rows if r.get(key) is not None]
            if points:
                x, y = np.array(points, float).T
                y = 100.0 * y if key == "settled" else y
                turn, colour = divmod(i, len(COLOURS))
                looks = {"color": COLOURS[colour], "linestyle": DASHES[turn % len(DASHES)]}
                looks |= {"marker": "o"} if len(points) == 1 else {}  # a line needs two
                axes.plot(x / 1e3, y, linewidth=1.4, markersize=4, label=name, **looks)
        axes.set(xlabel="environment steps [thousands]", ylabel=label)
        axes.set_xlim(left=0.0)
        tidy(axes)
    if len(runs) > 1:
        _as_written(figure.axes[0].legend(frameon=False, fontsize=8))
    figure.axes[1].set_ylim(-3.0, 103.0)
    _entitle(figure.axes[0], title)
    save_figure(figure, path)


def _entitle(axes: Any, title: str) -> None:
    """Title on the left, on as many lines as it needs."""
    axes.set_title(textwrap.fill(title, LINE), loc="left", fontsize=10, parse_math=False)


def _as_written(legend: Any) -> None:
    """Show names as they are: a dollar sign begins no formula."""
    for text in legend.get_texts():
        text.set_parse_math(False)


def plot_recordings(path: Path, recordings: Mapping[str, Recording], title: str) -> None:
    """Plot tip error (`error_band`) and the first episode's root curvature."""
    figure = new_figure(8.0, 5.6)
    error, curvature = figure.subplots(2, 1, sharex=True)
    for i, (name, r) in enumerate(recordings.items()):
        colour = COLOURS[i % len(COLOURS)]
        low, middle, high = error_band(r)
        error.plot(r.time, middle, color=colour, linewidth=1.6, label=name)
        error.fill_between(r.time, low, high, color=colour, alpha=0.15, linewidth=0.0)
        curvature.plot(r.time, bending(r), color=colour, linewidth=1.2)
    band = 100.0 * SETTLED_BAND
    error.axhline(band, color="black", linewidth=0.8, linestyle="--")
    error.annotate(
        "settled", (1.0, band), xycoords=("axes fraction", "data"), ha="right", va="bottom"
    )
    error.set(yscale="log", ylabel="tip error [% of reach]")
    _entitle(error, title)
    error.set_ylim(bottom=max(0.01, error.get_ylim()[0]))
    _as_written(figure.legend(frameon=False, loc="outside upper right", ncols=len(recordings)))
    curvature.set(xlabel="time [s]", ylabel="curvature at the root [1/m]\n(first episode)")
    curvature.set_xlim(0.0, max(r.time[-1] for r in recordings.values()))
    for axes in (error, curvature):
        tidy(axes)
    save_figure(figure, path)


def bending(recording: Recording) -> AnyArray:
    """(T,) [1/m] curvature at the root of the link that bends most, in the first episode."""
    curvature = recording.root_curvature[:, 0]
    chosen: AnyArray = curvature[:, np.nanargmax(np.nanmax(np.abs(curvature), axis=0))]
    return chosen


def error_band(recording: Recording) -> AnyArray:
    """(3, T) [% of reach] tip error below which 10, 50 and 90 % of the episodes are.

    That of an episode that has failed is infinite; a share that is not finite is not drawn.
    """
    percent = np.maximum(100.0 * recording.tip_error / recording.reach, 1e-3)
    percent[np.isnan(percent)] = np.inf
    return np.quantile(percent, (0.1, 0.5, 0.9), axis=1, method="inverted_cdf")


@dataclass(frozen=True)
class Film:
    """One episode: pictures, measured quantities, and the arm's form at every control step."""

    frames: list[AnyArray]  # (height, W, 3) every `frame_time`
    recording: Recording
    bent: AnyArray  # (N, links, points, 3) [m] centre lines
    straight: AnyArray  # (N, links, 2, 3) [m] ends of the links of the rigid arm
    target: AnyArray  # (N, 3) [m]
    planar: bool

    @property
    def frame_time(self) -> float:
        """Time from one picture to the next [s]."""
        control_dt = float(self.recording.time[1])
        return steps_per_frame(control_dt) * control_dt


def film(
    env_id: str,
    kwargs: Mapping[str, Any],
    controller: Controller,
    seed: int,
    height: int = GIF_HEIGHT,
) -> Film:
    """Run one episode on one environment, with pictures of a height [px]; terminals show a bar.

    The recorded episode is played again by its actions for the forms of the arm, and once more to
    draw them, so that the view of a spatial arm is known to hold all of its motion.
    """
    with closing(make_batch(env_id, 1, kwargs)) as envs:
        recording = record(controller, envs, [seed], "film")
    actions = recording.action[1:, 0].astype(np.float32)
    env: Any = gym.make(env_id, **{name: x for name, x in kwargs.items() if name != "threads"})
    with closing(env):
        core = env.unwrapped.core
        renderer = Renderer(core, height)
        forms = [renderer.forms(core) for _ in played(env, actions, seed)]
        if not renderer.planar:
            seen = [np.concatenate([*bent, target[None]]) for bent, _, target in forms]
            renderer.close_up(np.concatenate(seen))
        every, frames = steps_per_frame(core.control_dt), []
        for step in played(env, actions, seed):
            renderer.follow(core)
            if step % every == 0:
                frames.append(renderer.draw(core))
        bent, straight, target = (np.array(x) for x in zip(*forms, strict=True))
        return Film(frames, recording, bent, straight, target, renderer.planar)


def played(env: Any, actions: AnyArray, seed: int) -> Iterator[int]:
    """Play the episode of actions (T, m); yields the number of steps, from zero on."""
    env.reset(seed=seed)
    yield 0
    for step, action in enumerate(actions, start=1):
        env.step(action)
        yield step


def steps_per_frame(control_dt: float) -> int:
    """Control steps from one picture to the next: about GIF_SECONDS_PER_FRAME."""
    return max(1, round(GIF_SECONDS_PER_FRAME / control_dt))


def write_gif(path: Path, films: Mapping[str, Film], title: str) -> None:
    """Write a GIF: arms side by side, with strips of tip error and root curvature and a cursor.

    It plays in real time. A terminal shows a bar of progress.
    """
    n_frames = max(len(film.frames) for film in films.values())
    seconds = next(iter(films.values())).frame_time
    pictures = {name: [*map(Image.fromarray, film.frames)] for name, film in films.items()}
    width = sum(frames[0].width for frames in pictures.values())
    strips, to_pixel = draw_strips(
        {name: film.recording for name, film in films.items()}, width, title
    )
    bar = progress("GIF", n_frames)
    font = ImageFont.load_default(size=15)
    images = []
    for i in range(n_frames):
        canvas = Image.new("RGB", (width, GIF_HEIGHT + strips.height), "white")
        left = 0
        for k, (name, frames) in enumerate(pictures.items()):
            canvas.paste(frames[min(i, len(frames) - 1)], (left, 0))
            pen = ImageDraw.Draw(canvas)
            pen.text((left + 10, 8), name, fill=COLOURS[k % len(COLOURS)], font=font)
            left += frames[0].width
        canvas.paste(strips, (0, GIF_HEIGHT))
        x = to_pixel(i * seconds)
        ImageDraw.Draw(canvas).line((x, GIF_HEIGHT, x, canvas.height), fill="#444444")
        images.append(canvas)
        bar.update()
    bar.close()
    save_gif(path, images, seconds)


def save_gif(
    path: Path,
    images: Sequence[Image.Image],
    seconds: float = GIF_SECONDS_PER_FRAME,
    colours: int = 128,
) -> None:
    """Write pictures of one size as a looping GIF, `seconds` [s] per frame on average.

    A frame holds what has changed alone. GIF counts time in hundredths of a second: every frame
    ends at the nearest one.
    """
    palette = film_palette(images, colours - 1)
    none = Image.Dither.NONE
    frames = [np.asarray(image.quantize(palette=palette, dither=none)) for image in images]
    # The last colour is transparent, and stands where a frame is as the one before.
    same = colours - 1
    changes = [np.where(now == before, same, now) for before, now in pairwise(frames)]
    levels = (palette.getpalette() or [])[: 3 * colours]
    first, *others = (_framed(numbers, levels) for numbers in (frames[0], *changes))
    ends = np.rint(100.0 * seconds * np.arange(len(frames) + 1)).astype(int)
    with atomic_write(path) as temporary:
        first.save(
            temporary,
            save_all=True,
            append_images=others,
            duration=(10 * np.diff(ends)).tolist(),  # [ms]
            loop=0,
            optimize=False,
            transparency=same,
            disposal=1,
        )


def film_palette(images: Sequence[Image.Image], colours: int) -> Image.Image:
    """One palette for all frames, which avoids flicker and is smaller.

    The most frequent colours keep the ground, maximum coverage keeps the rare ones.
    """
    chosen = images[:: max(1, len(images) // 8)]
    width, height = images[0].size
    sample = Image.new("RGB", (width, height * len(chosen)))
    for i, image in enumerate(chosen):
        sample.paste(image, (0, i * height))
    rare = sample.quantize(colours - FREQUENT, method=Image.Quantize.MAXCOVERAGE)
    return palette_of(sample, rare, FREQUENT)


def palette_of(picture: Image.Image, others: Image.Image, frequent: int) -> Image.Image:
    """A palette of a picture's most frequent colours and those of `others`, then copies of one.

    A pixel counts by its colour, so that greys at the edges of letters do not push out a marker's.
    """
    counts: Any = picture.getcolors(picture.width * picture.height)
    counts.sort(key=lambda entry: entry[0] * (8 + max(entry[1]) - min(entry[1])))
    levels = [level for _, colour in counts[-frequent:] for level in colour]
    used: Any = others.getcolors()
    levels += (others.getpalette() or [])[: 3 * (1 + max(index for _, index in used))]
    palette = Image.new("P", (1, 1))
    palette.putpalette(levels + levels[:3] * (256 - len(levels) // 3))
    return palette


def _framed(numbers: AnyArray, levels: Sequence[int]) -> Image.Image:
    frame = Image.fromarray(numbers.astype(np.uint8))
    frame.putpalette(levels)
    return frame


def draw_strips(
    recordings: Mapping[str, Recording], width: int, title: str
) -> tuple[Image.Image, Any]:
    """The strips as one picture, and a function from time [s] to pixel column."""
    dpi = 100
    figure = new_figure(width / dpi, 2 * STRIP_HEIGHT / dpi, dpi)
    error, curvature = figure.subplots(2, 1, sharex=True)
    for i, r in enumerate(recordings.values()):
        colour = COLOURS[i % len(COLOURS)]
        error.plot(r.time, 100.0 * r.tip_error[:, 0] / r.reach, color=colour, linewidth=1.4)
        curvature.plot(r.time, bending(r), color=colour, linewidth=1.2)
    error.axhspan(0.0, 100.0 * SETTLED_BAND, color="#009e73", alpha=0.2, linewidth=0.0)
    error.set_ylim(bottom=0.0)
    error.set_title(title, loc="left", fontsize=8, parse_math=False)
    error.set_ylabel("tip error\n[% of reach]", fontsize=8)
    curvature.set_ylabel("root\ncurvature [1/m]", fontsize=8)
    curvature.set_xlabel("time [s]", fontsize=8)
    curvature.set_xlim(0.0, max(r.time[-1] for r in recordings.values()))
    for axes in (error, curvature):
        tidy(axes)
        axes.tick_params(labelsize=7)
    canvas: Any = figure.canvas
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    transform = curvature.transData

    def to_pixel(t: float) -> int:
        return round(transform.transform((min(t, curvature.get_xlim()[1]), 0.0))[0])

    return picture, to_pixel
