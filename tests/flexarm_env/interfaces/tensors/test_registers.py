"""Kernels of all ids compiled for an H100, which needs no GPU: their registers and spills."""

from typing import Any

import gymnasium as gym
import pytest

import flexarm_env  # noqa: F401  registers the ids
from dynamics.backends.cuda.compiler import usage
from dynamics.backends.cuda.kernel_text import DERIVATIVES
from flexarm_env.interfaces.tensors.device import kernel_source

IDS = sorted(x for x in gym.registry if x.startswith("FlexArm/"))
MOST = {"OneLink": 96, "TwoLink": 168, "FreeFlyer": 224, "SixLink": 255}  # registers in float32
SPILLED = {"SixLink": 6000}  # [B] of spill stores
BACK = {"OneLink": 0, "TwoLink": 400, "FreeFlyer": 3000, "SixLink": 40_000}  # [B], of derivatives


@pytest.mark.parametrize("env_id", IDS)
def test_kernels_keep_within_their_registers(env_id: str) -> None:
    pytest.importorskip("cuda.core")
    envs: Any = gym.make_vec(env_id, num_envs=1, dtype="float32")
    scene = env_id.removeprefix("FlexArm/").partition("-")[0]
    for name, found in usage(kernel_source(envs.core).text, "sm_90").items():
        assert found.registers <= MOST[scene], name
        assert found.stores <= SPILLED.get(scene, 0), name


@pytest.mark.parametrize("scene", BACK)
def test_derivatives_keep_within_their_spills(scene: str) -> None:
    pytest.importorskip("cuda.core")
    envs: Any = gym.make_vec(f"FlexArm/{scene}-Reach-v0", num_envs=1, dtype="float32")
    found = usage(kernel_source(envs.core, DERIVATIVES).text, "sm_90")
    assert found.keys() == DERIVATIVES
    assert max(of.stores for of in found.values()) <= BACK[scene]
