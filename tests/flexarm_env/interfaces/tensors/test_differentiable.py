"""Gradients through episodes, held against differences of episodes of the plain batch."""

import pytest
import torch

from flexarm_env import TorchVecEnv
from flexarm_env.interfaces.tensors.differentiable import DifferentiableBatch

ENV_ID, N, STEPS = "FlexArm/OneLink-Reach-v0", 6, 150
EXACT = 2.0**-10  # a step of actions that float32 adds without rounding


def batch(**keywords: object) -> TorchVecEnv:
    return TorchVecEnv(ENV_ID, N, differentiable=True, **keywords)


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


def test_gradients_stop_where_an_episode_starts() -> None:
    """A first observation depends on no earlier action; `final_obs` does."""
    envs = batch(max_episode_steps=3)
    envs.reset(seed=0)
    action = drawn(2, N, 1).requires_grad_()
    for _ in range(3):
        obs, reward, _, truncated, info = envs.step(action)
    assert truncated.all()
    (last,) = torch.autograd.grad(info["final_obs"].sum(), action, retain_graph=True)
    assert (last != 0.0).all()
    assert not obs.requires_grad or not torch.autograd.grad(obs.sum(), action)[0].any()
    assert reward.requires_grad


def test_detach_gives_the_state_by_which_later_steps_are_differentiated() -> None:
    """Nothing flows to what was before; `privileged` and the next step flow to the leaf."""
    envs = batch()
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


def test_where_a_simulation_diverges_gradients_are_zero() -> None:
    """And finite everywhere else."""
    envs = batch()
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


def test_what_has_no_gradients_is_refused_with_the_remedy() -> None:
    """Goals, and `detach` of a batch without gradients."""
    with pytest.raises(ValueError, match="obs must be 'state' or 'sensors' with differentiable"):
        batch(obs="goal")
    with pytest.raises(ValueError, match="differentiable=True"):
        TorchVecEnv(ENV_ID, 1).detach()
    envs = batch()
    assert isinstance(envs._batch, DifferentiableBatch)
    envs.reset()
    with pytest.raises(ValueError, match="finite"):
        envs.step(torch.full((N, 1), torch.nan))
