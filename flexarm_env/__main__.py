"""`python -m flexarm_env`: the preset arms, and the registered environments of each."""

import argparse
import sys

from dynamics.arms import ARMS
from flexarm_env.registration import IDS, SCENES

COLUMNS = ("arm", "links", "coordinates", "reach [m]", "environments")


def main(arguments: list[str] | None = None, prog: str = "python -m flexarm_env") -> int:
    """Print the table; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog=prog, description="List the preset arms and the environments of each."
    )
    parser.parse_args(arguments)
    print(table())
    print("\ngym.make(ID, arm=ARM) puts any of them, or an arm file, in place of the id's own arm.")
    print("Sources of the arms: python -m dynamics list")
    return 0


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
    sys.exit(main())
