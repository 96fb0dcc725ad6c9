"""Command line and output of every benchmark: provenance, JSON, Markdown tables, figures."""

import argparse
import os
import platform
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

from llvmlite.binding import get_host_cpu_name

from agents import figures
from agents.files import FolderError, check_folder, shortened, without_infinities, write_json
from agents.run_folder.folder import revision
from agents.sentences import one_line, speaker
from flexarm_env.accuracy.table import table as table

FOLDERS = ("--out", "--images", "--keep")  # options that say where results go, not what they are
DPI = 110.0
DIGITS = 6  # significant ones of a stored figure
ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
REFERENCE = ROOT / "tests" / "reference"


class Parser(argparse.ArgumentParser):
    """Command line whose places for results are checked and made before any work."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """The options; ends with one sentence where results could not be written."""
        options = super().parse_args(args, namespace)
        for option in FOLDERS:
            name = option.removeprefix("--")
            if (place := getattr(options, name, None)) is not None:
                try:
                    make_place(place, option, self.get_default(name))
                except ValueError as error:
                    self.exit(2, f"{speaker(self.prog)}: {one_line(error)}\n")
        if getattr(options, "charts", False) and not options.out.is_file():
            self.error(f"--charts draws stored results, but there is no {options.out}")
        return options


def make_place(place: Path, option: str, usual: Path | None) -> None:
    """Make the folder of an option, or of its file, where the usual place is a file."""
    if usual is None or not usual.suffix:
        folder = place
    elif place.suffix != usual.suffix or place.is_dir():
        raise FolderError(
            f"{option} takes the name of a {usual.suffix} file, such as "
            f"{place.with_suffix('') / usual.name}, got {place}."
        )
    else:
        folder = place.parent
    check_folder(folder, option)
    folder.mkdir(parents=True, exist_ok=True)


def count(text: str) -> int:
    """Whole number of an option, 1 or more."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"it must be 1 or more, got {number}")
    return number


def argument_parser(name: str, doc: str | None, out: str | None = None) -> Parser:
    """Parser of `python -m benchmarks.NAME`, described by the first line of a docstring.

    It has --out, by default the file `out` of docs/results, "." for the folder; none without `out`.
    """
    description = (doc or "").splitlines()[0]
    parser = Parser(prog=f"python -m benchmarks.{name}", description=description)
    if out is not None:
        usual = f"docs/results/{out}".removesuffix("/.")
        parser.add_argument(
            "--out", type=Path, default=RESULTS / out, help=f"of the results (default: {usual})"
        )
    return parser


def provenance(*packages: str) -> dict[str, Any]:
    """Machine, versions of Python and of the packages, commit and command."""
    return {
        "machine": {"processor": processor(), "cores": os.cpu_count()},
        "versions": {"python": platform.python_version(), **{p: version(p) for p in packages}},
        "commit": revision(),
        "command": command(),
    }


def command() -> str:
    """Command line of this process, as `python -m MODULE ARGUMENTS`, without those of FOLDERS."""
    spec = sys.modules["__main__"].__spec__
    module = spec.name.removesuffix(".__main__") if spec else Path(sys.argv[0]).name
    pairs = pairwise(["", *sys.argv[1:]])
    given = [x for before, x in pairs if before not in FOLDERS and x not in FOLDERS]
    return " ".join(["python", "-m", module, *given])


def processor() -> str:
    """Name of the processor, or its architecture where unknown, and LLVM's name of the target."""
    cpuinfo = Path("/proc/cpuinfo")  # Linux
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    name = next(iter(names), platform.processor() or platform.machine())
    return f"{name}, {get_host_cpu_name()}"


def paragraphs(*parts: str) -> str:
    """Markdown text of headings, paragraphs and tables, a blank line between them."""
    return "\n\n".join(parts) + "\n"


def fill(page: Path, blocks: Mapping[str, str]) -> None:
    """Fill the blocks of a stored page."""
    page.write_text(filled(page.read_text(encoding="utf-8"), blocks), encoding="utf-8")


def filled(page: str, blocks: Mapping[str, str]) -> str:
    """A page with these texts in its blocks `<!-- NAME --> ... <!-- /NAME -->`."""
    for name, text in blocks.items():
        before, mark, rest = page.partition(f"<!-- {name} -->")
        _, end, after = rest.partition(f"<!-- /{name} -->")
        if not end:
            raise ValueError(f"The page must hold the block {name!r}.")
        page = f"{before}{mark}\n\n{text}\n\n{end}{after}"
    return page


def write_results(path: Path, results: dict[str, Any]) -> Any:
    """Write results as strict JSON whose floats have DIGITS significant digits; what it holds."""
    stored = shortened(without_infinities(results), DIGITS)
    write_json(path, stored)
    return stored


def save_results(
    results: dict[str, Any], page: str | Callable[[Any], str], path: Path, figure: Any = None
) -> None:
    """Write results as strict JSON to `path`, and beside it their Markdown page and a chart.

    The page is printed too; a function makes it of the results as they are stored. The chart is a
    figure of pyplot.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    stored = write_results(path, results)
    text = page if isinstance(page, str) else page(stored)
    path.with_suffix(".md").write_text(text, encoding="utf-8")
    print(text)
    if figure is not None:
        save_figure(figure, path)


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure of pyplot as PNG of few colours, and close it."""
    import matplotlib.pyplot as plt

    figures.save_figure(figure, path.with_suffix(".png"), DPI)
    plt.close(figure)
