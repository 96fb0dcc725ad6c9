"""Experiments that come with the package, by name: those of a checkout or of a wheel."""

from pathlib import Path

from agents.config import ConfigError, hint
from dynamics.description import validate
from dynamics.description.data_file import user_path

HERE = Path(__file__).resolve().parent
FOLDERS = (HERE / "configs", HERE.parent / "configs")  # of a wheel; of a checkout


def shipped_experiments() -> dict[str, Path]:
    """Files of the shipped experiments by name."""
    folder = next((folder for folder in FOLDERS if folder.is_dir()), FOLDERS[0])
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find_experiment(given: str) -> Path:
    """Path of an experiment file, from its path or from the name of a shipped one.

    Raises
    ------
    ConfigError : for text that is neither; text with a suffix is always a path.
    """
    try:
        path, known = user_path(given), shipped_experiments()
    except ValueError as error:
        raise ConfigError(str(error)) from None
    if path.suffix or path.exists():
        return path
    if given not in known:
        raise ConfigError(
            f"{validate.shown(given)} is neither a file nor a shipped experiment. "
            f"{hint(given, known)}"
        )
    return known[given]
