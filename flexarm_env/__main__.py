"""`python -m flexarm_env`: the preset arms, the environments of each, and arms from URDF files."""

import argparse
import sys
from pathlib import Path
from typing import Any

import yaml

from dynamics.arms import ARMS
from dynamics.command import completed
from dynamics.description import validate
from dynamics.description.data_file import user_path
from dynamics.description.urdf.arm_text import arm_text
from dynamics.description.urdf.convert import convert
from flexarm_env.registration import IDS, SCENES

SUFFIXES = (".yaml", ".yml")  # of an arm file that is written
COLUMNS = ("arm", "links", "coordinates", "reach [m]", "environments")


def main(arguments: list[str] | None = None, prog: str = "python -m flexarm_env") -> int:
    """Print the table, or an arm file; returns the exit status."""
    options = _parser(prog).parse_args(arguments)
    if options.command is None:
        print(table())
        print("\ngym.make(ID, arm=ARM) puts any of them, or an arm file, in place of the id's own.")
        print("Sources of the arms: python -m dynamics list")
        return 0
    at = str(options.file)
    try:
        flexible = _flexible(options.flexible)
        if options.out is not None:
            _check_new(options.out)
        text = arm_text(convert(options.file, options.tip, flexible), options.file.name)
        if options.out is not None:
            at = str(options.out)
            options.out.write_text(text, encoding="utf-8")
    except OSError as error:
        print(f"{prog} convert: {at}: {error.strerror}.", file=sys.stderr)
        return 2
    except ValueError as error:
        print(f"{prog} convert: {at}: {error}", file=sys.stderr)
        return 2
    if options.out is None:
        print(text, end="")
    return 0


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=prog, description="List the preset arms and the environments of each."
    )
    commands = parser.add_subparsers(title="commands", dest="command", metavar="convert")
    conversion = commands.add_parser(
        "convert", help="write the arm file of a robot in a URDF file, to complete by hand"
    )
    add = conversion.add_argument
    add("file", type=user_path, metavar="FILE", help="URDF file")
    add("--tip", metavar="LINK", help="end of the arm, needed if the tree has several ends")
    add("--flexible", nargs="+", action="append", default=[], metavar=("LINK", "KEY=VALUE"),
        help="a link that bends, with keys of an arm file's link: --flexible link_3 EIz=40 EIy=40; "
        "repeated for every such link")  # fmt: skip
    add("--out", type=user_path, metavar="ARM.yaml", help="a new file, instead of standard output")
    return parser


def _check_new(out: Path) -> None:
    """Refuse an --out that is no arm file, or that is there already."""
    if out.suffix not in SUFFIXES:
        raise ValueError(f"--out must end in {' or '.join(SUFFIXES)}, got {out.name!r}.")
    if out.exists():
        raise ValueError(
            f"{out} is there already, perhaps completed by hand; name another --out, or remove it."
        )


def _flexible(options: list[list[str]]) -> dict[str, dict[str, Any]]:
    """Fields of flexible links by their names, from the words of every --flexible."""
    found: dict[str, dict[str, Any]] = {}
    for link, *pairs in options:
        if link in found:
            raise ValueError(f"--flexible {link} is given twice; give all its keys at once.")
        found[link] = _fields(link, pairs)
    return found


def _fields(link: str, pairs: list[str]) -> dict[str, Any]:
    """Fields of a flexible link, as typed."""
    values = []
    for pair in pairs:
        key, sign, value = pair.partition("=")
        if not sign:
            raise ValueError(f"--flexible {link}: expected KEY=VALUE, got {pair!r}.")
        try:
            values.append((key, yaml.safe_load(value)))
        except yaml.YAMLError:
            raise ValueError(f"--flexible {link}: {key} must be a number, got {value!r}.") from None
    return validate.unique(values, f"--flexible {link}")


def table() -> str:
    """Presets, one per line: name, links, coordinates, reach, and ids as `environments` has."""
    rows = [COLUMNS] + [
        (name, f"{len(arm.links)}", f"{arm.n}", f"{arm.reach:.2f}", environments(name))
        for name, arm in ARMS.items()
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(map(str.ljust, row, widths)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)


def environments(name: str) -> str:
    """Ids whose arm has this name, those of a scene together; "-" if there are none."""
    scenes = [scene for scene, (arm, _, _) in SCENES.items() if arm == name]
    found = []
    for start in (f"FlexArm/{scene}-" for scene in scenes):
        tasks = [x.removeprefix(start).removesuffix("-v0") for x in IDS if x.startswith(start)]
        several = len(tasks) > 1
        found.append(f"{start}{{{','.join(tasks)}}}-v0" if several else f"{start}{tasks[0]}-v0")
    return " ".join(found) or "-"


if __name__ == "__main__":
    sys.exit(completed("flexarm_env", main))
