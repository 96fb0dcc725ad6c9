"""The generated module of an environment can be printed, and the page that explains it is true."""

import re

import pytest

from dynamics.__main__ import main
from tests.paths import ROOT

PAGE = ROOT / "docs" / "compiled_step.md"


def printed(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["source", *arguments]) == 0
    return capsys.readouterr().out


def rounded(text: str) -> str:
    """The text with its numbers to ten digits: eigenvectors by LAPACK differ in the last ones."""
    return re.sub(r"\d+\.\d+(e-?\d+)?", lambda number: f"{float(number[0]):.10g}", text)


def test_the_page_quotes_the_module(capsys: pytest.CaptureFixture[str]) -> None:
    """Every listing, in this order."""
    page = PAGE.read_text(encoding="utf-8")
    (command,) = re.findall(r"python -m dynamics source (.*)", page)
    text = rounded(printed(command.split(), capsys))
    listings = re.findall(r"```text\n(.*?)```", rounded(page), re.S)
    assert len(listings) > 5
    at = 0
    for listing in listings:
        assert listing in text[at:], listing
        at = text.index(listing, at)
    (lines,) = re.findall(r"that output, (\d+) lines", page)
    assert abs(len(text.splitlines()) - int(lines)) < 10
    (statements,) = re.findall(r"has (\d+) statements", page)
    assert f"OPERATIONS = {statements}\n" in text
    (length,) = re.findall(r"in one such function, (\d+) lines here", page)
    report = text.split('report = straight_line("report", LANES, """\n')[1].split('"""')[0]
    # LAPACK of another processor tells equal numbers apart by their last digits
    assert abs(len(report.splitlines()) - int(length)) < 10
    assert compile(text, "module", "exec")


def test_an_arm_alone_has_a_steppers_module(capsys: pytest.CaptureFixture[str]) -> None:
    text = printed(["deluca-siciliano", "--integrator", "midpoint", "--lanes", "1"], capsys)
    assert "def advance(" in text
    assert "LANES = 1\n" in text
    assert "control_step" not in text


def test_an_environment_has_kernels_in_float32(capsys: pytest.CaptureFixture[str]) -> None:
    text = printed(["slim", "--env", "FlexArm/OneLink-Reach-v0", "--backend", "cuda"], capsys)
    assert "typedef float real;" in text
    assert "__global__ void control_step(" in text
    assert "straight_line" not in text


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["slim", "--env", "CartPole-v1"], "is not an environment of flexarm"),
        (["nobody"], "Unknown arm 'nobody'"),
        (["slim", "--backend", "cuda"], "add --env ID"),
        (["srms-like", "--env", "FlexArm/OneLink-Reach-v0"], None),
    ],
)
def test_what_has_no_source_is_refused_with_a_sentence(
    arguments: list[str], sentence: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    status = main(["source", *arguments])
    out, err = capsys.readouterr()
    if sentence is None:
        assert (status, err) == (0, "")
    else:
        assert (status, out) == (2, "")
        assert sentence in err
        assert err.count("\n") == 1
