"""The faster recurrent policy computes what sb3-contrib's does, and its gradients."""

from typing import Any

import pytest
import torch
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy

from agents.learners.recurrent import LstmPolicy

SEQUENCES, STEPS, INPUTS, UNITS = 5, 7, 3, 4


def starts_at(*places: tuple[int, int]) -> torch.Tensor:
    """Episode starts (SEQUENCES * STEPS,) with a one at each (sequence, step)."""
    starts = torch.zeros(SEQUENCES, STEPS)
    for place in places:
        starts[place] = 1.0
    return starts.flatten()


def processed(
    policy: type[RecurrentActorCriticPolicy], starts: torch.Tensor, layers: int
) -> list[torch.Tensor]:
    """Outputs, states, and gradients of weights, inputs and states of one pass."""
    torch.manual_seed(0)
    lstm = torch.nn.LSTM(INPUTS, UNITS, num_layers=layers)
    features = torch.randn(SEQUENCES * STEPS, INPUTS, requires_grad=True)
    states = tuple(torch.randn(layers, SEQUENCES, UNITS, requires_grad=True) for _ in range(2))
    outputs, last = policy._process_sequence(features, states, starts, lstm)
    inputs = [*lstm.parameters(), features, *states]
    gradients = torch.autograd.grad((outputs**2).sum() + (last[1] ** 2).sum(), inputs)
    return [outputs, *last, *gradients]


@pytest.mark.parametrize("layers", [1, 2])
@pytest.mark.parametrize(
    "starts",
    [starts_at(), starts_at((1, 0), (4, 0)), starts_at((0, 0), (2, 3))],
    ids=["none", "first", "within"],
)
def test_values_and_gradients_are_those_of_sb3_contrib(starts: torch.Tensor, layers: int) -> None:
    ours = processed(LstmPolicy, starts, layers)
    theirs = processed(RecurrentActorCriticPolicy, starts, layers)
    for ours_one, theirs_one in zip(ours, theirs, strict=True):
        torch.testing.assert_close(ours_one, theirs_one, rtol=1e-5, atol=1e-6)


def test_a_sequence_that_begins_an_episode_is_one_call_of_the_lstm() -> None:
    class Counted(torch.nn.LSTM):
        count = 0

        def forward(self, *args: Any) -> Any:
            Counted.count += 1
            return super().forward(*args)

    states = tuple(torch.zeros(1, SEQUENCES, UNITS) for _ in range(2))
    features = torch.zeros(SEQUENCES * STEPS, INPUTS)
    LstmPolicy._process_sequence(features, states, starts_at((1, 0)), Counted(INPUTS, UNITS))
    assert Counted.count == 1
