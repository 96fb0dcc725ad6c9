"""Policies in C, compiled as C99 without a warning, act as in Python."""

import math
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.controllers.models.reading import Reading
from agents.export.c_header import header
from agents.export.signals import Signals, signals_of
from agents.leaderboard.shipped import named_policy, shipped
from agents.metrics import make_batch
from agents.policy import Policy
from dynamics.types import AnyArray
from tests.agents.export.kinds import (
    ENV_ID,
    KINDS,
    RESTART,
    ROUND_OFF,
    laboratory,
    policy_of,
    readings,
    signals,
    torques,
)
from tests.paths import ROOT

COMPILER = shutil.which("cc")
STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1"]
MAIN = """
#include <stdio.h>
#include "policy.h"

int main(void)
{
    policy_memory memory;
    double input[POLICY_INPUTS], torque[POLICY_OUTPUTS];
    int begins;
    policy_start(&memory);
    while (scanf("%d", &begins) == 1) {
        for (int i = 0; i < POLICY_INPUTS; i++)
            if (scanf("%lf", &input[i]) != 1)
                return 1;
        if (begins)
            policy_start(&memory);
        printf("%d", policy_act(&memory, input, torque));
        for (int i = 0; i < POLICY_OUTPUTS; i++)
            printf(" %.17g", torque[i]);
        printf("\\n");
    }
    return 0;
}
"""
pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


def run(
    folder: Path, policy: Policy, wanted: Signals, rows: AnyArray, starts: AnyArray
) -> AnyArray:
    """(T, 1 + m) result and torques of a compiled policy."""
    (folder / "policy.h").write_text(header(policy, wanted, "policy"), encoding="ascii")
    (folder / "main.c").write_text(MAIN, encoding="ascii")
    lines = [f"{k:d} {' '.join(map(repr, x))}" for k, x in zip(starts, rows.tolist(), strict=True)]
    return np.array([line.split() for line in fed(compiled(folder, "main"), lines)], float)


def compiled(folder: Path, name: str) -> Path:
    """Program of a C file in the folder."""
    program = folder / name
    command = [str(COMPILER), *STRICT, "-o", str(program), str(folder / f"{name}.c"), "-lm"]
    subprocess.run(command, check=True)
    return program


def fed(program: Path, lines: list[str], *arguments: str) -> list[str]:
    """Lines that a program prints when it is given lines."""
    done = subprocess.run(
        [str(program), *arguments], input="\n".join(lines), capture_output=True, text=True
    )
    return done.stdout.splitlines()


@pytest.mark.parametrize("kind", KINDS)
def test_a_policy_of_every_kind_acts_in_c_as_in_python(kind: str, tmp_path: Path) -> None:
    policy, rows = policy_of(kind), readings()
    starts = np.isin(np.arange(len(rows)), (0, RESTART))
    found, expected = run(tmp_path, policy, signals(policy), rows, starts), torques(policy)
    assert not found[:, 0].any()
    most = laboratory().torque_limit[0]
    np.testing.assert_allclose(found[:, 1:], expected, atol=ROUND_OFF * most, rtol=0.0)
    assert np.ptp(expected) > 0.05 * most


def test_two_policies_of_one_name_are_an_error_and_one_may_be_included_twice(
    tmp_path: Path,
) -> None:
    (tmp_path / "main.c").write_text('#include "a/policy.h"\n#include "b/policy.h"\n' + MAIN)
    for kinds, status in (("tanh", "tanh"), 0), (("tanh", "relu"), 1):
        for folder, kind in zip("ab", kinds, strict=True):
            (tmp_path / folder).mkdir(exist_ok=True)
            policy = policy_of(kind)
            (tmp_path / folder / "policy.h").write_text(header(policy, signals(policy), "policy"))
        command = [str(COMPILER), *STRICT, "-fsyntax-only", "-I", "a", "main.c"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == status
    assert "another policy is named so too" in done.stderr


def test_a_trained_policy_gives_the_torques_of_its_environment(tmp_path: Path) -> None:
    """Readings of an episode in the laboratory go in; info has the torques that acted."""
    env_id, kwargs = "FlexArm/OneLink-Reach-v0", {"hardware": "laboratory"}
    policy = shipped(env_id, "laboratory")["ppo-stacked"][0]
    envs = make_batch(env_id, 1, kwargs)
    scales = np.concatenate(list(envs.unwrapped.observation_scales.values()))[:-1]
    observation, _ = envs.reset(seed=[3])
    rows, expected, state = [], [], None
    for _ in range(100):
        rows.append(observation[0, :-1] * scales)
        action, state = policy.predict(observation, state)
        observation, _, _, _, info = envs.step(action)
        expected.append(info["torque"][0])
    envs.close()
    starts = np.arange(100) == 0
    wanted = signals_of(policy, env_id, envs.unwrapped.core)
    found = run(tmp_path, policy, wanted, np.array(rows), starts)
    np.testing.assert_allclose(found[:, 1:], expected, atol=ROUND_OFF, rtol=0.0)
    assert np.abs(expected).max() > 0.9


def test_the_loop_of_the_page_turns_counts_into_the_torques_of_the_environment(
    tmp_path: Path,
) -> None:
    """Whole counts of encoder and gauge of an episode with late, noisy, biased readings.

    The policy is the one that the page exports.
    """
    env_id, kwargs = "FlexArm/OneLink-Reach-v0", {"hardware": "laboratory"}
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    policy = named_policy(page.partition("runs/")[2].partition("/")[0], 0)
    envs = make_batch(env_id, 1, kwargs)
    core, reading = envs.unwrapped.core, Reading.of(envs)
    text = header(policy, signals_of(policy, env_id, core), "policy")
    (tmp_path / "policy.h").write_text(text, encoding="ascii")
    (tmp_path / "loop.c").write_text(page.partition("```c\n")[2].partition("```")[0])
    program = compiled(tmp_path, "loop")
    observation, _ = envs.reset(seed=[5])
    target, lines, expected, state = core.joint_target()[0, 0], [], [], None
    for _ in range(100):
        angle = reading(observation, "joint_error")[0, 0] + target
        bend = reading(observation, "root_curvature")[0, 0] / core.gauge_scale[0]
        lines.append(f"{round(angle * 4096 / math.tau)} {round(1000 * bend)}")
        action, state = policy.predict(observation, state)
        observation, _, _, _, info = envs.step(action)
        expected.append(info["torque"][0, 0])
    envs.close()
    found = fed(program, lines, repr(float(target)))
    np.testing.assert_allclose([float(x) for x in found], expected, atol=1e-6, rtol=0.0)


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")
def test_a_header_is_c_plus_plus_too(tmp_path: Path) -> None:
    policy = policy_of("recurrent-stacked")
    (tmp_path / "policy.h").write_text(header(policy, signals(policy), "policy"))
    (tmp_path / "main.cpp").write_text(MAIN)
    command = ["c++", *STRICT[1:], "-fsyntax-only", str(tmp_path / "main.cpp")]
    subprocess.run(command, check=True)


def test_a_reading_that_is_not_a_number_gives_no_torque_and_is_forgotten(tmp_path: Path) -> None:
    policy, rows = policy_of("stacked"), readings()[:8]
    with_gap = np.insert(rows, 4, [0.1, np.nan, 0.1], axis=0)
    starts = np.arange(9) == 0
    found = run(tmp_path, policy, signals(policy), with_gap, starts)
    assert found[4].tolist() == [1.0, 0.0]
    whole = run(tmp_path, policy, signals(policy), rows, starts[:8])
    np.testing.assert_array_equal(np.delete(found, 4, axis=0), whole)


def test_the_header_states_what_goes_in_and_out() -> None:
    text = header(policy_of("tanh"), signals(policy_of("tanh")), "policy")
    for words in (
        f"A policy for {ENV_ID}",
        "Arm: slim. Control step: 0.02 s.",
        "the tip stays within",  # certificate
        "joint_rate      joint 1   rad/s",
        "root_curvature  link 1 y  1/m",
        "torque  joint 1  N m   at most 0.95",
        "experiment wi* /ld",  # text of a file ends no comment and continues no line
        "#define POLICY_CONTROL_STEP 0.02 /* s */",
        "POLICY_ROOT_CURVATURE = 2,",
    ):
        assert words in text


@pytest.mark.parametrize("actuator", [None, "quanser-servo"])
def test_the_last_output_of_a_driven_base_is_its_torque(actuator: str | None) -> None:
    kwargs = {"base_torque": 2.0, "actuator": actuator}
    core = make_batch("FlexArm/FreeFlyer-Reach-v0", 1, kwargs).unwrapped.core
    layer = {"weights": (np.zeros((3, core.layout.size)),), "biases": (np.zeros(3),)}
    bound = np.ones(core.layout.size)
    policy = replace(policy_of("tanh"), observation_low=-bound, observation_high=bound, **layer)
    rows = signals_of(policy, "FlexArm/FreeFlyer-Reach-v0", core).output_rows()
    assert [row[2] for row in rows] == ["joint 1", "joint 2", "base"]
    assert rows[0][-2:] == (("V", "at most 10") if actuator else ("N m", "at most 1.1"))
    assert rows[2][-2:] == ("N m", "at most 2")
