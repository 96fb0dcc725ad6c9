"""Arms without a window.

python -m dynamics evaluate CASE.json [--out FILE]   # M, h, accelerations, motion
python -m dynamics list                              # the preset arms
python -m dynamics source ARM [--env ID]             # the generated code of an arm
                [--backend llvm|cuda]
"""

import argparse
import json
import os
import sys
import warnings
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np

from dynamics.arms import ARMS
from dynamics.command import completed
from dynamics.description.data_file import user_path
from dynamics.integrators.table import INTEGRATORS
from dynamics.load import load_arm
from dynamics.simulation.case_file import Case, Motion, load_case

BACKENDS = ("llvm", "cuda")
SOURCES = "flexarm.sources"  # entry points of packages that generate modules of their own
BAD_INPUT = 2  # exit status: the file cannot be evaluated as it stands
DIVERGED = 3  # exit status: the motion left the finite numbers


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    options = _parser().parse_args(arguments)
    try:
        if options.command == "evaluate":
            return _evaluate(options.case, options.out)
        print(listing() if options.command == "list" else source(options))
    except BrokenPipeError:
        raise
    except (ValueError, OSError) as error:
        return _fail(error, BAD_INPUT)
    return 0


def _evaluate(path: Path, out: Path | None) -> int:
    if out is not None:
        check_target(out)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        case = load_case(path)
    for warning in caught:
        print(f"Warning: {path.name}: {warning.message}", file=sys.stderr)
    from dynamics.simulation.simulate import Diverged

    try:
        text = _json(evaluate(case))
    except Diverged as error:
        return _fail(error, DIVERGED)
    if out is None:
        print(text)
    else:
        write(out, text)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m dynamics", description="Arms with flexible links, without a window."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    evaluation = commands.add_parser(
        "evaluate", help="M, h, accelerations, frequencies and motion of a case, as JSON"
    )
    evaluation.add_argument("case", type=user_path, metavar="CASE", help="arm file (.json, .yaml)")
    evaluation.add_argument(
        "--out", type=user_path, metavar="FILE", help="instead of standard output"
    )
    commands.add_parser("list", help="the preset arms")
    printing = commands.add_parser("source", help="the generated code of an arm, as text")
    printing.add_argument("arm", metavar="ARM", help="a preset's name or an arm file")
    printing.add_argument("--env", metavar="ID", help="with the control step of this environment")
    printing.add_argument(
        "--backend", choices=BACKENDS, default="llvm", help="cuda: kernels, with --env"
    )
    printing.add_argument(
        "--integrator", choices=INTEGRATORS, default="rk4", help="without --env (default: rk4)"
    )
    printing.add_argument(
        "--lanes", type=int, choices=(1, 16), default=16, help="environments side by side"
    )
    return parser


def listing() -> str:
    """The presets, one per line: name, links, coordinates, reach, description."""
    width = max(len(name) for name in ARMS)
    rows = [
        f"{arm.name:{width}} {len(arm.links)} links  {arm.n:2} coordinates  {arm.reach:.2f} m  "
        f"{arm.description}"
        for arm in ARMS.values()
    ]
    return "\n".join(rows)


def source(options: argparse.Namespace) -> str:
    """Text of the generated code of an arm: its stepper's, or an environment's."""
    if options.env is not None:
        return environment_source(options.arm, options.env, options.backend)
    if options.backend == "cuda":
        raise ValueError("--backend cuda prints the control step of an environment; add --env ID.")
    from dynamics.backends.numba_llvm.program import generate, stepping
    from dynamics.tracing.traced_arm import TracedArm

    arm = TracedArm(load_arm(options.arm))
    return generate(arm, "float64", options.lanes, options.integrator, stepping(arm))


def environment_source(arm: str, env_id: str, backend: str) -> str:
    """Text of an environment's code, from the package that offers it as an entry point."""
    for entry in entry_points(group=SOURCES):
        return str(entry.load()(arm, env_id, backend))
    raise ValueError(
        "--env needs flexarm's environments, which are not installed: pip install -e ."
    )


def evaluate(case: Case) -> dict[str, Any]:
    """Results that a case requests, as plain lists and numbers.

    They follow from the positions: with `rotation` "linear" Book's Lagrangian differentiates
    1 + theta~, where the arm has nothing that his formulation lacks.
    """
    from dynamics.formulations.table import why_not
    from dynamics.model import compile_arm

    of_positions = case.arm.rotation == "linear" and why_not(case.arm, "book") is None
    model = compile_arm(case.arm, formulation="book" if of_positions else "gibbs_appell")
    q = np.zeros(model.n)
    q[list(case.arm.joint_index)] = case.joint_angles
    result: dict[str, Any] = {"names": list(model.names), "states": []}
    for state in case.states:
        at, rate, tau = np.array(state.q), np.array(state.qd), np.array(state.tau)
        result["states"].append({
            "M": model.mass_matrix(at).tolist(),
            "h": model.bias(at, rate).tolist(),
            "acc": model.accelerations(at, rate, tau).tolist(),
        })  # fmt: skip
    result["frequencies_rad_s"] = {
        f"joints_{joints}": model.frequencies(q, joints=joints).tolist()
        for joints in ("locked", "free")
    }
    if case.motion is not None:
        result["motion"] = _follow(model, case.motion)
    return result


def check_target(path: Path) -> None:
    """Refuse, before any work, a file that could not be written."""
    if path.is_dir():
        raise ValueError(f"--out must be a file, got the folder {path}.")
    if not path.parent.is_dir():
        raise ValueError(f"--out needs an existing folder, got {path.parent}; create it first.")


def write(path: Path, text: str) -> None:
    """Replace a file in one step: it is either the old one or complete."""
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        fresh.write_text(text + "\n", encoding="utf-8")
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


def _follow(model: Any, motion: Motion) -> dict[str, Any]:
    from dynamics.simulation.simulate import simulate

    start = np.array(motion.q), np.array(motion.qd)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        path = simulate(model, *start, motion.torque, motion.times)
    for warning in caught:
        print(f"Warning: {warning.message}", file=sys.stderr)
    states = list(zip(path.q, path.v, strict=True))
    energies = [model.energy(q, v) for q, v in states]
    result = {
        "t": path.t.tolist(),
        "tip": path.tip.tolist(),
        "q": path.q.tolist(),
        "qd": path.v.tolist(),
        "T": [float(kinetic) for kinetic, _, _ in energies],
        "V": [float(elastic + gravity) for _, elastic, gravity in energies],
    }
    if path.base_quaternion is None:
        return result
    turned = path.q.copy()
    if model.arm.base.spatial:
        turned[:, 3:6] = 0.0  # from the attitude that stands beside
    momenta = [model.momentum(q, v) for q, v in states]
    return result | {
        "q": turned.tolist(),
        "base_quaternion": path.base_quaternion.tolist(),
        "linear_momentum": [linear.tolist() for linear, _ in momenta],
        "angular_momentum_about_origin": [angular.tolist() for _, angular in momenta],
    }


def _json(result: dict[str, Any]) -> str:
    try:
        return json.dumps(result, allow_nan=False)
    except ValueError:
        raise ValueError(
            "A result is not finite: a state is too large, or the mass matrix is singular there."
        ) from None


def _fail(error: Exception, status: int) -> int:
    print(" ".join(str(error).split()), file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(completed("dynamics", main))
