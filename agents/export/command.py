"""`flexarm export RUN --format c`: a policy for programs without Python.

The policy of a run becomes one C99 header, or an ONNX model.
"""

import argparse
import re
import sys
from contextlib import closing
from pathlib import Path

from agents.environments import REFUSALS
from agents.evaluate import UsageError, find_env, stored_policy
from agents.export.c_header import header
from agents.export.signals import Signals, signals_of
from agents.files import FolderError, atomic_write, check_folder
from agents.metrics import make_batch
from agents.policy import Policy, PolicyError
from agents.sentences import refused
from dynamics.command import completed
from dynamics.description import validate
from dynamics.description.data_file import user_path

SUFFIXES = {"c": ".h", "onnx": ".onnx"}
IDENTIFIER = re.compile(r"[a-z][a-z0-9_]{0,62}")


def main(arguments: list[str] | None = None, prog: str = "python -m agents.export.command") -> int:
    """Run the command line; returns the exit status (2 and one sentence for unusable input)."""
    parser = argparse.ArgumentParser(
        prog=prog, description="Write the policy of a run as a C99 header or as an ONNX model."
    )
    parser.add_argument(
        "run", metavar="RUN", type=user_path, help="folder of a run, or of a policy"
    )
    parser.add_argument("--format", choices=SUFFIXES, required=True, help="c, or onnx")
    parser.add_argument(
        "--out",
        type=user_path,
        metavar="FILE",
        help="file to write, named as a variable of C (default: policy.h or policy.onnx in RUN)",
    )
    a = parser.parse_args(arguments)
    try:
        print(f"Written: {export(a.run, a.format, a.out)}")
    except (UsageError, PolicyError, FolderError, ModuleNotFoundError) as error:
        return refused(prog, error)
    except OSError as error:
        return refused(prog, f"writing to {a.out or a.run} failed ({error.strerror or error}).", 1)
    return 0


def export(run: Path, form: str, out: Path | None = None) -> Path:
    """Write the policy of a run in a format of SUFFIXES; returns the file.

    Nothing is written before the policy, its environment and the file's name are checked.
    """
    policy, run = stored_policy(run)
    out = run / f"policy{SUFFIXES[form]}" if out is None else out
    name = checked_name(out, SUFFIXES[form])
    check_folder(out.parent)
    if not policy.about.get("env_id"):
        raise PolicyError(
            f"{run}: the policy names no environment, from which scales and units come; store it "
            "with env_id and env_kwargs in the table `about` of export_policy(model, about)."
        )
    env_id, kwargs = find_env(policy, None, None)
    try:
        env = make_batch(env_id, 1, kwargs)
    except REFUSALS as error:
        raise UsageError(f"{env_id} with {validate.shown(kwargs)}: {error}") from None
    with closing(env):
        signals = signals_of(policy, env_id, env.unwrapped.core)
    content = serialised(form, policy, signals, name)
    out.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(out) as path:
        path.write_bytes(content)
    return out


def serialised(form: str, policy: Policy, signals: Signals, name: str) -> bytes:
    """Content of the file."""
    if form == "c":
        return header(policy, signals, name).encode("ascii")
    from agents.export.onnx_file import model

    content: bytes = model(policy, signals, name).SerializeToString()
    return content


def checked_name(out: Path, suffix: str) -> str:
    """Name of the file without its suffix, with which everything in the file begins."""
    if out.suffix != suffix or not IDENTIFIER.fullmatch(out.stem):
        raise UsageError(
            f"--out must be a file such as policy{suffix}, named in lower-case letters, digits and "
            f"underscores, got {validate.shown(str(out))}."
        )
    return out.stem


if __name__ == "__main__":
    sys.exit(completed("agents.export.command", main))
