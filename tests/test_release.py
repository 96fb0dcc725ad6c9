"""Metadata, citation and the workflow of a public forge agree with the project."""

import os
import re
import subprocess
import tomllib
from typing import Any

import pytest
import yaml

from tests.paths import ROOT

PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
WORKFLOW: dict[Any, Any] = yaml.safe_load(
    (ROOT / ".github" / "workflows" / "ci.yml").read_text("utf-8")
)
PYTHONS = {
    name.rpartition(" ")[2] for name in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", name)
}


def test_the_citation_is_of_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors", "type"} <= set(citation)
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    assert [author["name"] for author in citation["authors"]] == [
        author["name"] for author in PROJECT["authors"]
    ]


def test_the_workflow_tests_every_python_that_the_package_names() -> None:
    jobs = WORKFLOW["jobs"].values()
    named = {
        version
        for job in jobs
        for version in job.get("strategy", {}).get("matrix", {}).get("python", [])
    }
    named |= {
        step["with"]["python-version"]
        for job in jobs
        for step in job["steps"]
        if "with" in step and "{{" not in step["with"]["python-version"]
    }
    assert named == PYTHONS
    assert PROJECT["requires-python"] == f">={min(PYTHONS, key=lambda v: int(v[2:]))}"


def test_the_workflow_runs_scripts_that_are_there() -> None:
    """On two systems, from wheels; at night all tests, for which one library has no wheel."""
    runs = [s["run"] for job in WORKFLOW["jobs"].values() for s in job["steps"] if "run" in s]
    scripts = [ROOT / run for run in runs if run.startswith(".ci/")]
    assert {script.name for script in scripts} == {"run", "nightly", "oldest"}
    assert all(os.access(script, os.X_OK) for script in scripts)
    systems = WORKFLOW["jobs"]["readme"]["strategy"]["matrix"]["os"]
    assert [name.partition("-")[0] for name in systems] == ["ubuntu", "macos"]
    assert WORKFLOW["env"]["PIP_ONLY_BINARY"] == ":all:"
    assert [name for name, job in WORKFLOW["jobs"].items() if "env" in job] == ["nightly"]


def test_the_nightly_tests_run_by_the_clock_and_nothing_else_does() -> None:
    assert WORKFLOW[True]["schedule"]  # YAML reads the key `on` as true
    clock = {
        name: job["if"] == "github.event_name == 'schedule'"
        for name, job in WORKFLOW["jobs"].items()
    }
    assert [name for name, nightly in clock.items() if nightly] == ["nightly"]
    assert WORKFLOW["jobs"]["nightly"]["steps"][-1]["run"] == ".ci/nightly"


@pytest.mark.parametrize("name", ["run", "nightly", "oldest"])
def test_the_scripts_are_shell_without_errors(name: str) -> None:
    subprocess.run(["bash", "-n", str(ROOT / ".ci" / name)], check=True)


def test_every_library_has_a_lower_bound_that_the_script_installs() -> None:
    script = (ROOT / ".ci" / "oldest").read_text("utf-8")
    assert "--resolution lowest-direct" in script
    assert "--extra test" in script
    extras = PROJECT["optional-dependencies"]
    named = [*PROJECT["dependencies"], *extras["train"], *extras["test"]]
    assert [x for x in named if ">=" not in x] == ["flexarm[train,export]"]  # of the extra test
