"""README and start page: short, true, and with a way to every page."""

import math
import re
import subprocess
import sys
from pathlib import Path

import pytest

from flexarm_env.accuracy.certificates import stored
from flexarm_env.accuracy.motions import KINDS
from tests.paths import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
START = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
LINK = re.compile(r"(?<!!)\[[^\]]+\]\(([^)#]+)[^)]*\)")
FURTHER = ("index",)  # pages without a row on the start page


def section(page: str, title: str) -> str:
    """Text between a heading of the second level and the next one."""
    return re.split(r"^## ", page.partition(f"## {title}\n")[2], flags=re.MULTILINE)[0]


def bullets() -> list[str]:
    """Claims that a user may rely on, without their heading."""
    return section(README, "What you may rely on").split("\n- ")[1:]


def test_the_readme_is_short() -> None:
    assert len(README.splitlines()) < 90
    assert README.count("![") == 1
    assert len(bullets()) == 5
    assert len(LINK.findall(section(README, "Where to go"))) == 6
    assert "git clone --depth 1" in README


def test_the_first_lines_of_python_are_eight_and_run(tmp_path: Path) -> None:
    (code,) = re.findall(r"^```python\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)
    assert len(code.splitlines()) == 8
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(Path.home()), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) > 0.0


@pytest.mark.parametrize("bullet", bullets())
def test_the_numbers_of_a_promise_are_on_the_page_that_it_names(bullet: str) -> None:
    (page,) = LINK.findall(bullet)
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    words = LINK.sub("", " ".join(bullet.split()))
    numbers = r"\b\d+ of \d+\b|\b\d[\d.]*\d? million\b|\b\d[\d.]*\d\b|\bthousandth\b|\bv0\b"
    for number in re.findall(numbers, words):
        assert number in text, number


def test_the_promised_accuracy_is_that_of_the_certificates() -> None:
    """One link, two links and the free flyer, but for a drop; six links at their own conditions."""
    shares, until, dropped = [], [], []
    for arm, found in stored().items():
        for k, entry in enumerate(found["measured"]):
            for name, kind in entry["certificate"]["episodes"]["kinds"].items():
                if entry["certificate"]["holds"].get("drop"):
                    dropped.append(kind["share"])
                elif arm != "six-link":
                    shares.append(kind["share"])
                elif k == 0 and not KINDS[name].shaken and kind["until"][0]:
                    until.append(kind["until"][0])
    (promise,) = [bullet for bullet in bullets() if "Accuracy" in bullet]
    assert f"{math.ceil(1e4 * max(shares)) / 10} thousandths" in promise
    assert f"{math.floor(10 * min(until)) / 10} s from rest" in promise
    assert f"{math.ceil(1e3 * max(dropped))} thousandths once a payload is dropped" in promise


@pytest.mark.parametrize("name", ["README.md", "docs/index.md"])
def test_links_lead_to_files(name: str) -> None:
    page = ROOT / name
    found = [link for link in LINK.findall(page.read_text("utf-8")) if "://" not in link]
    assert [link for link in found if not (page.parent / link).exists()] == []


def test_every_page_is_in_a_group_of_the_start_page() -> None:
    shown = set(LINK.findall(section(START, "Where to go")))
    pages = {path.name for path in (ROOT / "docs").glob("*.md") if path.stem not in FURTHER}
    pages |= {f"{name}/README.md" for name in ("envs", "reference", "results")}
    assert pages - shown == set()
