"""Results of a step as tensors."""

from typing import Any, NamedTuple

import torch

from flexarm_env.compiled.outputs import SETTLED, WIDE, scalars
from flexarm_env.compiled.rows import Rows
from flexarm_env.compiled.termination import FLAGS
from flexarm_env.task.rewards import TERMS

Info = dict[str, Any]  # tensors by name; "reward_terms" is a dict of tensors


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
