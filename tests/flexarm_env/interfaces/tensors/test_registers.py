"""Kernels of all ids compiled for an H100, which needs no GPU: their registers and spills."""

from typing import Any

import gymnasium as gym
import pytest

import flexarm_env  # noqa: F401  registers the ids
from dynamics.backends.cuda.compiler import usage
from flexarm_env.interfaces.tensors.device import kernel_source

IDS = sorted(x for x in gym.registry if x.startswith("FlexArm/"))
MOST = {"OneLink": 96, "TwoLink": 168, "FreeFlyer": 224, "SixLink": 255}  # registers in float32
SPILLED = {"SixLink": 6000}  # [B] of spill stores


@pytest.mark.parametrize("env_id", IDS)
def test_kernels_keep_within_their_registers(env_id: str) -> None:
    pytest.importorskip("cuda.core")
    envs: Any = gym.make_vec(env_id, num_envs=1, dtype="float32")
    scene = env_id.removeprefix("FlexArm/").partition("-")[0]
    for name, found in usage(kernel_source(envs.core).text, "sm_90").items():
        assert found.registers <= MOST[scene], name
        assert found.stores <= SPILLED.get(scene, 0), name
