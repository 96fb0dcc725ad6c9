"""The plant of an environment: step and certificate follow what changes; copies keep both."""

import copy
import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import flexarm_env  # noqa: F401  registers the ids
from dynamics import load_arm

ID = "FlexArm/OneLink-Reach-v0"
DRAWN: dict[str, Any] = {"payload_mass": (0.0, 0.0), "stiffness": (1.0, 1.0)}


def made(**keywords: Any) -> Any:
    return gym.make(ID, **({"randomize": DRAWN} | keywords))


def motion(env: Any) -> np.ndarray:
    return np.array([env.step(np.array([sign], np.float32))[0] for sign in 4 * [1.0] + 4 * [-1.0]])


def test_step_and_certificate_follow_what_is_drawn() -> None:
    """A stiffer plant takes the finer step that one built so takes; a copy keeps the step."""
    env: Any = made().unwrapped
    env.reset(seed=0)
    env.step(np.ones(1, np.float32))
    assert "payload_mass drawn from 0 to 0" in env.uncertified  # a part of the laboratory's plants
    for factor in (100.0, 1.0):
        env.randomize = DRAWN | {"stiffness": (factor, factor)}
        assert env.core.substeps == 15  # of the running episode, too
        assert env.certificate is None
        env.reset(seed=0)
        built = made(randomize=env.randomize, integrator=env.core.integrator, substeps=15)
        built.reset(seed=0)
        for other in (copy.deepcopy(env), built):
            np.testing.assert_array_equal(motion(copy.deepcopy(env)), motion(other))
    assert made(randomize={"stiffness": (100.0, 100.0)}).unwrapped.core.substeps == 15
    env = made().unwrapped
    env.deflection_limit = 0.3
    assert env.certificate is None
    assert "deflections above 0.1" in env.uncertified


def test_a_copy_does_not_read_the_arm_file_again(tmp_path: Path) -> None:
    path = tmp_path / "own.json"
    path.write_text(json.dumps(load_arm("slim").to_dict()))
    env = gym.make(ID, arm=str(path))
    path.unlink()
    assert copy.deepcopy(env).unwrapped.arm == env.unwrapped.arm  # type: ignore[attr-defined]


def test_a_certificate_is_not_changed_through_another_environment() -> None:
    gym.make(ID).unwrapped.certificate["holds"].clear()  # type: ignore[attr-defined]
    assert gym.make(ID).unwrapped.certificate["holds"]  # type: ignore[attr-defined]
