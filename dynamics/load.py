"""Load an arm from a preset's name, a file or a dict."""

import warnings
from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from dynamics.arms import ARMS
from dynamics.description.arm import Arm
from dynamics.description.arm_file import arm_from_dict
from dynamics.description.data_file import MOST_BYTES, read_mapping, user_path
from dynamics.description.plausibility import warn_if_implausible
from dynamics.description.urdf.convert import Flexible, UrdfWarning, convert
from dynamics.description.urdf.robot import SUFFIX
from dynamics.description.validate import shown, unknown

ArmSource = str | PathLike[str] | Mapping[str, Any] | Arm  # accepted by `load_arm`


def load_arm(source: ArmSource, *, flexible: Flexible | None = None, tip: str | None = None) -> Arm:
    """Return an arm from a preset's name, a path (.json, .yaml, .yml, .urdf) or a dict.

    An `Arm` is returned unchanged. A case file is also an arm file: its motion and expected results
    are ignored. Numbers of no arm, as lengths in mm, give an ImplausibleArmWarning,
    links that are too thick for slender beams a ThickLinkWarning, shapes too stiff before a weld a
    StiffSegmentsWarning.

    Of a URDF file, `flexible` and `tip` choose the links that bend and the end of the chain, see
    `dynamics.description.urdf.convert`; an UrdfWarning says what the arm does not take over.

    Raises
    ------
    ValueError : for an unknown preset, a file that cannot be read, or the description of no arm;
        one sentence with the file, the field and its value.
    """
    if _is_urdf(source):
        return _from_urdf(user_path(source), flexible, tip)  # type: ignore[arg-type]
    if flexible is not None or tip is not None:
        raise ValueError(
            f"flexible and tip are of a {SUFFIX} file, got {shown(source)}; leave them out."
        )
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
    path = user_path(source)
    if isinstance(source, str) and path.suffix == "":
        raise ValueError(
            f"{unknown(source, 'arm', ARMS)} Presets: {sorted(ARMS)}; or give the path of a "
            f".json, .yaml or {SUFFIX} file."
        )
    if path.suffix.lower() not in MOST_BYTES:
        known = f"{', '.join(MOST_BYTES)} or {SUFFIX}"
        raise ValueError(f"{path.name or path}: must end in {known}, got {shown(path.suffix)}.")
    try:
        return arm_from_dict(read_mapping(path))
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def _is_urdf(source: ArmSource) -> bool:
    return isinstance(source, str | PathLike) and Path(fspath(source)).suffix.lower() == SUFFIX


def _from_urdf(path: Path, flexible: Flexible | None, tip: str | None) -> Arm:
    try:
        found = convert(path, tip, flexible)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error
    if found.notes:
        sentence = f"{path.name}, not taken over: {'; '.join(found.notes)}."
        warnings.warn(sentence, UrdfWarning, stacklevel=3)
    return found.arm


def _as_long_as_a_preset(arm: Arm) -> bool:
    """True for a preset and its models: their sizes are known, and stated on their pages."""
    preset = ARMS.get(arm.name)
    lengths = [[link.length for link in x.links] for x in (arm, preset) if x]
    return len(lengths) == 2 and lengths[0] == lengths[1]
