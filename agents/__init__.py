"""Training, classical controllers and headless evaluation for the flexarm environments."""

from pathlib import Path

import dynamics

if Path(dynamics.__file__).resolve().parents[1] != Path(__file__).resolve().parents[1]:
    raise ImportError(
        f"{dynamics.__file__} hides flexarm's package 'dynamics'; rename it, or run from another "
        "folder."
    )
