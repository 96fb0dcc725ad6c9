"""Text of an arm file of a converted robot, with comments: where links come from, what is left."""

import textwrap

import yaml

from dynamics.description.urdf.convert import Conversion
from dynamics.description.validate import shown

WIDTH = 98
HEAD = (
    "Converted from {file} by `flexarm arms convert`, to complete by hand: a URDF states no rotor "
    "inertia and no spring of a joint, and neither stiffness nor damping of a link that bends."
)


def arm_text(conversion: Conversion, file: str) -> str:
    """YAML of an arm, which `load_arm` reads as the same arm.

    Parameters
    ----------
    file : name of the URDF file.
    """
    data = conversion.arm.to_dict()
    links = data.pop("links")
    lines = textwrap.wrap(HEAD.format(file=shown(file)), WIDTH)
    if conversion.notes:
        lines.append("Not taken over:")
        lines += [_wrapped(f"- {note}") for note in conversion.notes]
    parts = [_comment("\n".join(lines)), _yaml(data), "links:\n"]
    for source, link in zip(conversion.sources, links, strict=True):
        parts += [_comment(_wrapped(source)), _yaml([link])]
    return "".join(parts)


def _wrapped(text: str) -> str:
    return textwrap.fill(text, WIDTH, subsequent_indent="  ", break_on_hyphens=False)


def _comment(text: str) -> str:
    return "".join(f"# {line}\n" for line in text.splitlines())


def _yaml(data: object) -> str:
    return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=WIDTH)
