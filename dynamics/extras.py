"""Optional libraries: the line that installs an extra, and the error of an import that needs it."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]  # a checkout, or the folder of all installed packages


def installation(extra: str) -> str:
    """Advice that installs an extra: of the checkout, if this is one, else of the package."""
    if (ROOT / "constraints.txt").is_file():
        return f'run in the folder of flexarm: pip install -c constraints.txt -e ".[{extra}]"'
    return f'run: pip install "flexarm[{extra}]"'


def missing(error: ModuleNotFoundError, needed_by: str, extra: str) -> ModuleNotFoundError:
    """Error that names the missing library, the part that needs it and the remedy."""
    return ModuleNotFoundError(
        f"{needed_by} needs {error.name}, which is not installed; {installation(extra)}",
        name=error.name,
    )
