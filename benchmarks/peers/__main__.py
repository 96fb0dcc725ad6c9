"""Flexible scenes by Exudyn, MuJoCo and flexarm: tip error against processor time, in one process.

    python -m benchmarks.peers [--quick] [--out FILE] [--images FOLDER] [--truth]
    python -m benchmarks.peers --charts [--out FILE] [--images FOLDER]

Every engine simulates the same scenes with many models, methods and steps; its cheapest runs at
each error form its line. `--quick` takes fewer of them; `--truth` only recomputes the truths, which
takes a quarter of an hour; `--charts` draws stored results. Runs need the optional engines: pip
install "flexarm[peers]".
"""

import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.output import RESULTS, argument_parser, provenance, save_results
from benchmarks.peers.charts import draw, headline
from benchmarks.peers.lines import comparisons, page, summary
from benchmarks.peers.scenes import SCENES
from benchmarks.peers.truth import make_truths


def draw_all(results: dict[str, Any], folder: Path) -> None:
    """Draw the lines of all engines, and the headline of the README."""
    draw(results, folder / "peers")
    headline(results, folder / "error_against_speed")


def main() -> None:
    """Simulate all scenes with all engines; write JSON, a page and the picture."""
    parser = argument_parser("peers", __doc__, "peers.json")
    parser.add_argument("--quick", action="store_true", help="few models and methods")
    parser.add_argument("--images", type=Path, default=RESULTS)
    parser.add_argument("--truth", action="store_true", help="only recompute the truths")
    parser.add_argument("--charts", action="store_true", help="only draw the stored results")
    options = parser.parse_args()
    if options.truth:
        make_truths()
        return
    if options.charts:
        draw_all(json.loads(options.out.read_text(encoding="utf-8")), options.images)
        return
    try:
        from benchmarks.peers import sweep  # imports the optional engines
    except ModuleNotFoundError as error:
        sys.exit(str(error))
    results = provenance("exudyn", "mujoco", "numba", "numpy")  # of the code that now runs
    everything = {
        name: sweep.time_again(scene, sweep.explore(scene, options.quick))
        for name, scene in SCENES.items()
    }
    results |= {
        "comparisons": [
            row for name, points in everything.items() for row in comparisons(SCENES[name], points)
        ],
        "scenes": {name: summary(SCENES[name], points) for name, points in everything.items()},
    }
    save_results(results, page, options.out)
    draw_all(results, options.images)


if __name__ == "__main__":
    main()
