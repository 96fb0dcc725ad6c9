"""Gradients through episodes, held against differences of episodes of the plain batch.

Those of kernels, compiled for the host, are held against those of the processor.
"""

import copy
import pickle
from typing import Any

import numpy as np
import pytest
import torch
from torch.autograd.graph import saved_tensors_hooks
from torch.utils._python_dispatch import TorchDispatchMode

from dynamics.backends.cuda.compiler import Kernels
from dynamics.backends.cuda.kernel_text import PUSH_FORWARD
from flexarm_env import TorchVecEnv
from flexarm_env.derivatives import Derivatives
from flexarm_env.interfaces.tensors import vec_env
from flexarm_env.interfaces.tensors.device import DeviceDerivatives, DeviceProgram
from flexarm_env.interfaces.tensors.differentiable import (
    DifferentiableBatch,
    differentiable_on_device,
)
from flexarm_env.interfaces.tensors.host import HostDerivatives
from tests.flexarm_env.interfaces.tensors import test_device as device
from tests.host_kernels import COMPILER, HostKernels

ENV_ID, N, STEPS = "FlexArm/OneLink-Reach-v0", 6, 150
EXACT = 2.0**-10  # a step of actions that float32 adds without rounding
CPU = torch.device("cpu")
CASES = device.CASES | {"two links": ("TwoLink-Reach", {}), "six links": ("SixLink-Reach", {})}
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")
both = pytest.mark.parametrize("kernels", [False, pytest.param(True, marks=needs_compiler)])


def batch(kernels: bool = False, differentiable: bool | str = True, **keywords: Any) -> TorchVecEnv:
    """A batch of the processor, or of kernels that are compiled for it."""
    envs = TorchVecEnv(ENV_ID, N, differentiable=differentiable, **keywords)
    if kernels:
        recomputed = differentiable == "recomputed"
        envs._batch = differentiable_on_device(envs.core, CPU, HostKernels, recomputed)
    return envs


def drawn(seed: int, *shape: int) -> torch.Tensor:
    """Numbers in [-1/2, 1/2] that are multiples of EXACT."""
    uniform = torch.rand(shape, generator=torch.Generator().manual_seed(seed)) - 0.5
    return (uniform / EXACT).round() * EXACT


def rewards(envs: TorchVecEnv, actions: torch.Tensor) -> torch.Tensor:
    """(N,) sums of rewards over episodes under given actions (T, N, n_torque)."""
    envs.reset(seed=0)
    return torch.stack([envs.step(action)[1] for action in actions]).sum(0)


def test_the_gradient_of_a_whole_episode_is_that_of_the_plain_batch() -> None:
    """150 steps, to the end of the episode; the numbers of both batches are equal to round-off."""
    plain, actions, along = TorchVecEnv(ENV_ID, N), drawn(0, STEPS, N, 1), drawn(1, STEPS, N, 1)
    given = actions.clone().requires_grad_()
    total = rewards(batch(), given)
    torch.testing.assert_close(total.detach(), rewards(plain, actions), rtol=1e-12, atol=1e-12)
    (gradient,) = torch.autograd.grad(total.sum(), given)

    def difference(h: float) -> torch.Tensor:
        both = (rewards(plain, actions + s * along) for s in (h, -h))
        ahead, behind = both
        return (ahead - behind) / (2.0 * h)

    exact = (4.0 * difference(EXACT) - difference(2.0 * EXACT)) / 3.0
    found = (gradient.double() * along).sum((0, 2))
    torch.testing.assert_close(found, exact, rtol=1e-5, atol=1e-5 * float(exact.abs().max()))


@both
def test_gradients_stop_where_an_episode_starts(kernels: bool) -> None:
    """A first observation depends on no earlier action; `final_obs` does."""
    envs = batch(kernels, max_episode_steps=3)
    envs.reset(seed=0)
    action = drawn(2, N, 1).requires_grad_()
    for _ in range(3):
        obs, reward, _, truncated, info = envs.step(action)
    assert truncated.all()
    (last,) = torch.autograd.grad(info["final_obs"].sum(), action, retain_graph=True)
    assert (last != 0.0).all()
    assert not obs.requires_grad or not torch.autograd.grad(obs.sum(), action)[0].any()
    assert reward.requires_grad


@both
def test_detach_gives_the_state_by_which_later_steps_are_differentiated(kernels: bool) -> None:
    """Nothing flows to what was before; `privileged` and the next step flow to the leaf."""
    envs = batch(kernels)
    envs.reset(seed=0)
    early = drawn(3, N, 1).requires_grad_()
    envs.step(early)
    state = envs.detach()
    envs.privileged().sum().backward()
    rows = envs.core.signals.state.slices
    assert state.grad is not None
    assert state.grad[rows["q"], :N].any()
    state.grad = None
    envs.step(drawn(4, N, 1))[1].sum().backward()
    assert state.grad is not None
    assert (state.grad[rows["v"].start, :N] != 0.0).all()
    assert early.grad is None


@both
def test_where_a_simulation_diverges_gradients_are_zero(kernels: bool) -> None:
    """And finite everywhere else."""
    envs = batch(kernels)
    envs.reset(seed=0)
    rows = envs.core.signals.state.slices
    state = envs.detach()
    with torch.no_grad():
        state[rows["v"].start + 1, 0] = 1e200
    action = drawn(5, N, 1).requires_grad_()
    _, reward, terminated, _, info = envs.step(action)
    assert info["diverged"].tolist() == [True] + [False] * (N - 1)
    assert terminated[0]
    reward.sum().backward()
    assert action.grad is not None
    assert action.grad[0] == 0.0
    assert (action.grad[1:] != 0.0).all()
    assert state.grad is not None
    assert not state.grad[:, 0].any()


@both
def test_recomputed_gradients_are_the_same_and_keep_no_stack(kernels: bool) -> None:
    """Across a restart; torch keeps fewer numbers of a step than the stack has."""
    found, kept = [], []
    for kind in (True, "recomputed"):
        envs, actions = batch(kernels, kind, max_episode_steps=4), drawn(7, 6, N, 1)
        envs.reset(seed=0)
        sizes: list[int] = []
        actions.requires_grad_()
        with saved_tensors_hooks(lambda x, sizes=sizes: sizes.append(x.numel()) or x, lambda x: x):
            total = sum(envs.step(action)[1].sum() for action in actions)
        found.append(torch.autograd.grad(total, actions)[0])
        kept.append(sum(sizes))
    assert torch.equal(*found)
    fixed, per_substep = Derivatives(envs.core)._program.STACK
    assert kept[0] - kept[1] >= len(actions) * N * (fixed + per_substep)


@pytest.mark.parametrize("kind", [True, "recomputed"])
@pytest.mark.parametrize(
    ("name", "value"), [("reward", {"tracking": 5.0}), ("randomize", {"stiffness": (0.9, 16.0)})]
)
def test_gradients_after_a_change_of_the_step_are_refused(
    kind: bool | str, name: str, value: Any
) -> None:
    """They would be those of other weights, or of more substeps than were recorded."""
    envs = batch(differentiable=kind, randomize={"stiffness": (0.9, 1.1)})
    envs.reset(seed=0)
    reward = envs.step(drawn(8, N, 1).requires_grad_())[1].sum()
    envs.envs.deflection_limit = 0.09
    reward.backward(retain_graph=True)
    setattr(envs.envs, name, value)
    with pytest.raises(RuntimeError, match="before you set reward or randomize"):
        reward.backward()


def test_what_has_no_gradients_is_refused_with_the_remedy() -> None:
    """Goals, `detach` of a batch without gradients, and second derivatives."""
    with pytest.raises(ValueError, match="differentiable must be True, False or 'recomputed'"):
        batch(differentiable="stack")
    with pytest.raises(ValueError, match="obs must be 'state' or 'sensors' with differentiable"):
        batch(obs="goal")
    with pytest.raises(ValueError, match="differentiable=True"):
        TorchVecEnv(ENV_ID, 1).detach()
    envs = batch()
    assert isinstance(envs._batch, DifferentiableBatch)
    envs.reset()
    placed = {"target": torch.zeros(1, requires_grad=True)}
    with pytest.raises(ValueError, match=r"options\['target'\] .* Use tensor.detach"):
        envs.reset(options=placed)
    with pytest.raises(ValueError, match="finite"):
        envs.step(torch.full((N, 1), torch.nan))
    actions = drawn(9, N, 1).requires_grad_()
    with pytest.raises(RuntimeError, match="no second derivatives"):
        torch.autograd.grad(envs.step(actions)[1].sum(), actions, create_graph=True)


def moving(name: str, dtype: str) -> tuple[Any, torch.Tensor, torch.Tensor]:
    """Core of a case in motion, its state with unused columns, and actions beyond their limits."""
    env_id, keywords = CASES[name]
    envs = device.made(f"FlexArm/{env_id}-v0", dtype=dtype, **keywords)
    envs.reset(seed=3)
    core, rng = envs.core, np.random.default_rng(0)
    for size in (0.6, 0.6, 1.2):
        actions = rng.uniform(-size, size, envs.action_space.shape).astype(np.float32)
        if size < 1.0:
            core.step(actions)
    return core, torch.from_numpy(core.state.copy()), torch.from_numpy(actions)


def used(array: Any) -> torch.Tensor:
    """Columns of the environments of a padded array."""
    return torch.as_tensor(array)[:, : device.N].contiguous()


def gap(found: torch.Tensor, expected: Any) -> float:
    """Largest difference, relative to the largest number or to 1."""
    exact = torch.as_tensor(expected)
    exact = (exact if found.shape == exact.shape else used(exact)).double()
    return float((found.double() - exact).abs().max() / exact.abs().max().clamp(min=1.0))


@needs_compiler
@pytest.mark.parametrize("dtype", device.TOLERANCES)
@pytest.mark.parametrize("name", CASES)
def test_kernels_have_the_derivatives_of_the_processor(name: str, dtype: str) -> None:
    """Recorded step; cotangents, and derivatives along a direction, of random ones.

    Stacks begin with what the workspace held before, of which nothing is needed.
    """
    core, state, actions = moving(name, dtype)
    host, kernels = HostDerivatives(core), DeviceDerivatives(core, CPU, HostKernels)
    expected = host.record(state, actions)
    found = kernels.record(used(state), actions)
    gaps = [gap(a, b) for a, b in zip(found[:4], expected[:4], strict=True)]

    torch.manual_seed(0)
    along, obs, info, by = (torch.randn_like(x) for x in (*expected[:3], actions))
    lost = torch.zeros(state.shape[1], dtype=torch.bool)
    back = host.pull_back(lost, state, actions, expected[4], along, obs, info)
    bars = used(along), obs, used(info)
    backward = kernels.pull_back(lost[: device.N], used(state), actions, found[4], *bars)
    gaps += [gap(a, b) for a, b in zip(backward, back, strict=True)]

    program = DeviceProgram(core, CPU, (PUSH_FORWARD,), HostKernels)
    new, moved = program.outputs(), {f"{k}_mirror": x for k, x in program.outputs().items()}
    moved |= {"state_mirror": used(along), "actions_mirror": by}
    program.run(PUSH_FORWARD, state=used(state), actions=actions, **new, **moved)
    forward = moved["state_mirror"], moved["obs_mirror"].T, moved["info_mirror"]
    given = (x.numpy() for x in (state, actions, along, by))
    exact = host._derivatives.push_forward(*given)
    gaps += [gap(a, b) for a, b in zip(forward, exact, strict=True)]
    assert all(x <= device.TOLERANCES[dtype] for x in gaps), gaps


@needs_compiler
def test_gradients_of_episodes_are_equal_on_both() -> None:
    """Across restarts within steps, by the actions and by the state at the start."""
    found = []
    for kernels in (False, True):
        envs, actions = batch(kernels, max_episode_steps=4), drawn(6, 10, N, 1).requires_grad_()
        envs.reset(seed=0)
        start, total = envs.detach(), torch.zeros(())
        for action in actions:
            obs, reward, _, _, info = envs.step(action)
            total = total + (reward.sum() + (obs + info["final_obs"]).sum()) + info["time"].sum()
        total = total + envs.privileged().sum()
        by = torch.autograd.grad(total, (start, actions))
        found.append([total, obs, envs.state, by[0][:, :N], by[1]])
    for a, b in zip(*found, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-6, atol=1e-6)  # of float32 observations


@needs_compiler
def test_nothing_waits_for_the_device() -> None:
    """No operation of a step or of the way back reads a number on the host."""

    class Seen(TorchDispatchMode):
        def __torch_dispatch__(
            self, func: Any, types: Any, args: Any = (), kwargs: Any = None
        ) -> Any:
            names.add(func.overloadpacket.__name__)
            return func(*args, **(kwargs or {}))

    names: set[str] = set()
    envs = batch(True, max_episode_steps=2)
    envs.reset(seed=0)
    actions = drawn(7, N, 1).requires_grad_()
    with Seen():
        for _ in range(3):
            _, reward, _, _, info = envs.step(actions)
        (reward.sum() + info["final_obs"].sum() + envs.privileged().sum()).backward()
    assert actions.grad is not None
    assert "where" in names
    assert not names & {"_local_scalar_dense", "nonzero", "equal"}


def test_a_differentiable_batch_of_a_gpu_has_its_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vec_env, "differentiable_on_device", lambda *given: given)
    envs = TorchVecEnv(ENV_ID, 1).envs
    given: Any = vec_env._batch(envs, torch.device("cuda", 3), "recomputed")
    core, on, compiled, recomputed = given
    assert (core, on.index, recomputed) == (envs.core, 3, True)
    assert compiled.func is Kernels
    assert compiled.keywords == {"device": 3}


@both
def test_steps_in_inference_mode_leave_a_batch_that_has_gradients(kernels: bool) -> None:
    """As those without gradients do: evaluation between two trainings, and its actions."""
    found = []
    for mode in (torch.no_grad, torch.inference_mode):
        envs = batch(kernels, max_episode_steps=3)
        with mode():
            envs.reset(seed=0)
            for action in drawn(10, 4, N, 1):
                envs.step(action)
            envs.envs.deflection_limit = 0.09
            envs.privileged()
            given = drawn(11, N, 1)
        actions = drawn(12, N, 1).requires_grad_()
        total = envs.step(given)[1].sum() + envs.step(actions)[1].sum() + envs.privileged().sum()
        found.append(torch.autograd.grad(total, actions)[0])
    assert found[0].all()
    assert torch.equal(*found)


def test_a_copy_of_a_differentiable_batch_has_gradients_from_its_present_state() -> None:
    """By both ways of copying, in the middle of a graph; the graph stays with the first one."""
    envs, early = batch(), drawn(13, N, 1).requires_grad_()
    envs.reset(seed=0)
    envs.step(early)
    copies = copy.deepcopy(envs), pickle.loads(pickle.dumps(envs))
    for other in copies:
        assert other.core is not envs.core
        assert torch.equal(other.state, envs.state)
    actions = drawn(14, 2, N, 1).requires_grad_()
    totals = [sum(x.step(a)[1].sum() for a in actions) for x in (envs, *copies)]
    gradient, *others = (torch.autograd.grad(x, actions, retain_graph=True)[0] for x in totals)
    assert all(torch.equal(gradient, x) for x in others)
    assert torch.autograd.grad(totals[0], early)[0].any()
    with pytest.raises(RuntimeError, match="not have been used in the graph"):
        torch.autograd.grad(totals[1], early)


def test_the_states_that_only_follow_the_graph_are_read_only() -> None:
    """In a copy too; a plain batch, which steps them, takes what a program writes."""
    envs = batch()
    for own in (envs, pickle.loads(pickle.dumps(envs))):
        own.reset(seed=0)
        for array in (own.core.q, own.core.v, own.core.parameters):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.1
        own.step(torch.zeros(N, 1))
        np.testing.assert_array_equal(own.core.q.T, own.state[own.core.signals.state.slices["q"]]
                                      .detach().numpy())  # fmt: skip
    plain = TorchVecEnv(ENV_ID, N)
    plain.reset(seed=0)
    plain.core.q[...] = 0.1
    assert (plain.state[plain.core.signals.state.slices["q"]] == 0.1).all()
