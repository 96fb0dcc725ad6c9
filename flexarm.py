"""`flexarm COMMAND ...`: the commands of this package, each also a module.

Only the module of the command is imported. A folder or a file of the user's own with the name of
one of our packages is refused with a sentence.
"""

import argparse
import os
import sys
import warnings
from functools import partial
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

COMMANDS = {  # module whose `main` runs the command, and its line in the help
    "train": ("agents.training", "train a policy from an experiment file, and compare it"),
    "evaluate": ("agents.evaluate", "evaluate a run's policy or a classical controller"),
    "export": ("agents.export.command", "write a run's policy as a C header or an ONNX model"),
    "sweep": ("agents.sweep.command", "search the settings of an experiment, by Ray"),
    "leaderboard": ("agents.leaderboard.run", "rank controllers on tasks and tracks"),
    "certify": ("flexarm_env.certify.run", "measure the errors of an arm's model and step"),
    "fit": ("agents.fit", "fit an arm's stiffness and damping to a log of its rig"),
    "arms": (
        "flexarm_env.__main__",
        "list the preset arms with their environments, or convert a URDF file",
    ),
}
EXTRAS = {"sweep": "scale"}  # other than `train`
PACKAGES = ("dynamics", "flexarm_env", "agents")
MISSING = 2  # exit status: something is not installed, ours is hidden, or no folder is present
INTERRUPTED = 130  # exit status, as a shell has it: Ctrl-C


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns its exit status."""
    given = sys.argv[1:] if arguments is None else arguments
    if not given or given[0] not in COMMANDS:
        parser().parse_args(given or ["--help"])
    if faults := [sentence for sentence in (gone(), *map(shadow, PACKAGES)) if sentence]:
        print(f"flexarm: {faults[0]}", file=sys.stderr)
        return MISSING
    from dynamics.command import completed

    name = given[0]
    try:
        return completed(f"flexarm {name}", partial(command, name, given[1:]))
    except KeyboardInterrupt:
        print(f"flexarm {name}: interrupted.", file=sys.stderr)
        return INTERRUPTED


def command(name: str, arguments: list[str]) -> int:
    """Import the module of a command, and run it; returns its exit status."""
    try:
        run = import_module(COMMANDS[name][0]).main
    except ModuleNotFoundError as error:
        print(
            f"flexarm: {name} needs {error.name}, which is not installed; "
            f"{installation(EXTRAS.get(name, 'train'))}",
            file=sys.stderr,
        )
        return MISSING
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: print(
            f"flexarm {name}: {message}", file=sys.stderr
        )
        status: int = run(arguments, prog=f"flexarm {name}")
    return status


def installation(extra: str) -> str:
    """Advice of `dynamics.extras.installation`, which cannot be imported without its libraries."""
    if (Path(__file__).resolve().parent / "constraints.txt").is_file():
        return f'run in the folder of flexarm: pip install -c constraints.txt -e ".[{extra}]"'
    return f'run: pip install "flexarm[{extra}]"'


def parser() -> argparse.ArgumentParser:
    """Parser of the command's name alone; the command parses the rest."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name:{width}}  {line}" for name, (_, line) in COMMANDS.items()]
    result = argparse.ArgumentParser(
        prog="flexarm",
        description="Robot arms whose links bend: train, evaluate and rank what controls them.",
        epilog="\n".join(["commands:", *lines, "", "flexarm COMMAND --help says more."]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("--version", action="version", version=f"flexarm {version('flexarm')}")
    result.add_argument("command", choices=COMMANDS, metavar="COMMAND", help="one of those below")
    return result


def gone() -> str:
    """Sentence about a present folder that was removed; empty if it is there."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return "the present folder was removed; go to another one."
    return ""


def shadow(package: str) -> str:
    """Sentence about a user's own module that hides one of our packages; empty if none does."""
    spec = find_spec(package)
    found = Path(spec.origin).resolve() if spec is not None and spec.origin else None
    if found == Path(__file__).resolve().parent / package / "__init__.py":
        return ""
    return (
        f"{found or package} hides flexarm's package {package!r}; rename it, or run from another "
        "folder."
    )


if __name__ == "__main__":
    sys.exit(main())
