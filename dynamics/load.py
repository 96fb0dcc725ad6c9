"""Load an arm from a preset's name, a file or a dict."""

from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from dynamics.arms import ARMS
from dynamics.description.arm import Arm
from dynamics.description.arm_file import arm_from_dict
from dynamics.description.data_file import read_mapping
from dynamics.description.plausibility import warn_if_implausible
from dynamics.description.validate import shown

ArmSource = str | PathLike[str] | Mapping[str, Any] | Arm  # accepted by `load_arm`


def load_arm(source: ArmSource) -> Arm:
    """Return an arm from a preset's name, a path (.json, .yaml, .yml) or a dict.

    An `Arm` is returned unchanged. A case file is also an arm file: its motion and expected results
    are ignored. Numbers of no arm, as lengths in mm, give an ImplausibleArmWarning,
    links that are too thick for slender beams a ThickLinkWarning.
    """
    if isinstance(source, Arm):
        if not _as_long_as_a_preset(source):
            warn_if_implausible(source, stacklevel=2)
        return source
    if isinstance(source, Mapping):
        return arm_from_dict(source)
    if isinstance(source, str) and source in ARMS:
        return ARMS[source]
    if not isinstance(source, str | PathLike):
        raise ValueError(
            f"An arm is a preset name, a path, a dict or an Arm, got {type(source).__name__}."
        )
    path = Path(fspath(source))
    if isinstance(source, str) and path.suffix == "":
        raise ValueError(
            f"Unknown arm {shown(source)}. Presets: {sorted(ARMS)}; or give the path of a "
            ".json or .yaml file."
        )
    try:
        return arm_from_dict(read_mapping(path))
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def _as_long_as_a_preset(arm: Arm) -> bool:
    """True for a preset and its models: their sizes are known, and stated on their pages."""
    preset = ARMS.get(arm.name)
    lengths = [[link.length for link in x.links] for x in (arm, preset) if x]
    return len(lengths) == 2 and lengths[0] == lengths[1]
