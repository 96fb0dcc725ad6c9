"""Pages of the documentation: their code runs, and they explain every key."""

import builtins
import re
import shlex
import subprocess
import symtable
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from PIL import Image

from agents.experiments import shipped_experiments
from agents.films import FILMED
from dynamics import Body, Joint, Link, Mode, Payload, Section
from dynamics.description.arm import Base
from dynamics.description.arm_file import ARM_KEYS, CASE_KEYS
from dynamics.description.denavit_hartenberg import Row
from flexarm_env.pages.environments import film_name
from tests.paths import ROOT

DOCS = ROOT / "docs"
RUN = ("index", "own_arm", "sensors", "certificate", "controller", "faq", "actuators", "urdf")
BLOCK = re.compile(r"^```(python|yaml|bash|xml)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
SHORT = {  # of the pages -> in the tests
    "total_steps: 500_000": "total_steps: 4_096",
    "learn(100_000": "learn(2_048",
    "--episodes 20": "--episodes 2",
    "--tracks state": "--tracks state --episodes 2",
}
KEYS = {
    "The arm": ARM_KEYS,
    "A link": [entry.name for entry in fields(Link)],
    "A section": [entry.name for entry in fields(Section)],
    "A joint": [entry.name for entry in fields(Joint)],
    "A mode": [entry.name for entry in fields(Mode)],
    "A payload": [entry.name for entry in fields(Payload)],
    "A base": [*(entry.name for entry in fields(Base)), "euler"],
    "A body": [entry.name for entry in fields(Body)],
    "A row of Denavit and Hartenberg": [entry.name for entry in fields(Row)],
}
LARGEST_FILM = 300_000  # bytes


def blocks(page: str) -> list[tuple[str, str]]:
    """Language and short form of the code blocks of a page."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    for long, short in SHORT.items():
        text = text.replace(long, short)
    return BLOCK.findall(text)


def followed(page: str, folder: Path) -> list[str]:
    """Run the Python of a page in a folder, its named blocks as files; returns its commands."""
    code, commands = "", []
    for language, text in blocks(page):
        named = re.match(r"(?:#|<!--) (\w+\.(?:py|yaml|urdf))(?: -->)?\n", text)
        if named:
            (folder / named[1]).write_text(text, encoding="utf-8")
        elif language == "python":
            code += text
        elif language == "bash":
            commands += text.replace("\\\n", "").splitlines()
    run([sys.executable, "-c", code], folder)
    return commands


def run(command: list[str], folder: Path) -> None:
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(Path.home()), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{command}:\n{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize("page", RUN)
def test_the_python_of_a_page_runs(page: str, tmp_path: Path) -> None:
    followed(page, tmp_path)


def test_every_answer_imports_what_it_uses() -> None:
    """Questions are read one at a time."""
    for _, code in blocks("faq"):
        for name in symtable.symtable(code, "faq", "exec").get_symbols():
            bound = name.is_assigned() or name.is_imported()
            assert bound or hasattr(builtins, name.get_name()), name


@pytest.mark.slow
@pytest.mark.parametrize("page", ["own_arm", "controller", "urdf"])
def test_the_commands_of_a_page_run(page: str, tmp_path: Path) -> None:
    for command in followed(page, tmp_path):
        words = shlex.split(command.replace("train.py", str(ROOT / "train.py")))
        own = {"python": [], "flexarm": ["-m", "flexarm"]}[words[0]]
        run([sys.executable, *own, *words[1:]], tmp_path)


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *sorted(DOCS.glob("*.md"))], ids=lambda x: x.name
)
def test_experiments_that_a_page_names_are_shipped(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"(?:flexarm train |configs/)([a-z]\w+)(?:\.yaml| )", text)
    assert [name for name in named if name not in shipped_experiments()] == []


@pytest.mark.parametrize("section", KEYS)
def test_every_key_of_an_arm_file_is_explained(section: str) -> None:
    """One row per key that the loader accepts, and none beside."""
    text = (DOCS / "own_arm.md").read_text(encoding="utf-8")
    body = re.split(r"^#+ ", text.partition(f"### {section}\n")[2], flags=re.MULTILINE)[0]
    assert sorted(re.findall(r"^\| `(\w+)`", body, re.MULTILINE)) == sorted(KEYS[section])


def test_ignored_keys_are_named() -> None:
    text = (DOCS / "own_arm.md").read_text(encoding="utf-8")
    assert [key for key in CASE_KEYS if f"`{key}`" not in text] == []


@pytest.mark.parametrize("env_id", FILMED)
def test_a_film_of_every_id_moves_and_is_small(env_id: str) -> None:
    """If not: python -m agents.films"""
    path = DOCS / "envs" / "films" / film_name(env_id)
    assert path.stat().st_size < LARGEST_FILM
    with Image.open(path) as film:
        assert film.n_frames > 50
        first = film.convert("RGB").tobytes()
        film.seek(film.n_frames - 1)
        assert film.convert("RGB").tobytes() != first
