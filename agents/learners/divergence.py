"""Trainings that diverge, which ends in weights that are not finite."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class TrainingError(ValueError):
    """A training that cannot continue; the message is one sentence for the user."""


@contextmanager
def divergence_told(model: Any) -> Iterator[None]:
    """Raise TrainingError for a training that diverges, which torch reports in various ways."""
    try:
        yield
    except ValueError:
        refuse_divergence(model)
        raise
    refuse_divergence(model)


def refuse_divergence(model: Any) -> None:
    """Raise TrainingError if weights are not finite."""
    if not all(parameter.isfinite().all() for parameter in model.policy.parameters()):
        raise TrainingError(
            "the training has diverged: weights of the network are not finite; start again with a "
            "smaller agent.kwargs.learning_rate."
        ) from None
