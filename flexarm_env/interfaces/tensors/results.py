"""Results of a step as tensors."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import torch

from flexarm_env.compiled.outputs import SETTLED, WIDE, scalars
from flexarm_env.compiled.rows import Rows
from flexarm_env.compiled.termination import FLAGS
from flexarm_env.task.rewards import TERMS
from flexarm_env.task.tasks import SETTLED_BAND

Info = dict[str, Any]  # tensors by name; "reward_terms" is a dict of tensors


@contextmanager
def ordinary() -> Iterator[None]:
    """Context whose tensors may carry gradients later, even within torch's inference mode."""
    with_gradients = torch.is_grad_enabled()
    with torch.inference_mode(False), torch.set_grad_enabled(with_gradients):
        yield


class Results(NamedTuple):
    """Results of a step, N environments each."""

    obs: torch.Tensor  # (N, size) the first of a new episode where one has ended
    last: torch.Tensor  # (N, size) before that
    reward: torch.Tensor  # (N,)
    terminated: torch.Tensor  # (N,) bool
    truncated: torch.Tensor  # (N,) bool
    info: Info


def named_info(info: torch.Tensor, flags: torch.Tensor, names: Rows) -> Info:
    """Info by name of rows (rows, N) and flags (len(FLAGS), N): views."""
    at = names.slices
    found: Info = {name: info[at[name].start] for name in scalars(names)}
    found |= {name: info[at[name]].T for name in WIDE if name in at}
    found |= dict(zip(FLAGS[SETTLED:], flags[SETTLED:], strict=True))
    found["reward_terms"] = dict(zip(TERMS, info[at["reward_terms"]], strict=True))
    return found


def goal_reward(obs: torch.Tensor, size: int) -> torch.Tensor:
    """(N,) bool rewards of `rewards.goal_reward`, of observations that end with two goals."""
    achieved, desired = obs[:, -2 * size :].double().split(size, dim=1)
    return torch.linalg.vector_norm(achieved - desired, dim=1) < SETTLED_BAND
