"""Keywords whose values may change between steps.

They are constants of the compiled step, and ranges from which a reset draws, so that nothing is
compiled again.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from dynamics.description import validate
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from flexarm_env import arguments
from flexarm_env.task.rewards import TERMS, resolve_weights
from flexarm_env.task.scales import SLOPE_PER_DEFLECTION
from flexarm_env.task.tasks import Range, Task


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Checked values of the keywords that may change."""

    weights: dict[str, float]  # of the reward's terms
    deflection_limit: float  # [-]
    max_steps: int  # 0: no limit
    ranges: dict[str, Range]  # of the free parameters, in the order in which they are compiled

    @property
    def constants(self) -> dict[str, Any]:
        """Constants of the compiled step that follow from them."""
        return {
            "max_steps": self.max_steps,
            "deflection_limit": self.deflection_limit,
            "slope_limit": SLOPE_PER_DEFLECTION * self.deflection_limit,
            "weights": [self.weights.get(name, 0.0) for name in TERMS],
        }

    def after(self, former: "Settings") -> "Settings":
        """These in place of `former` ones: free parameters without a range are nominal again.

        Parameters that were not compiled are refused.
        """
        new = sorted(set(self.ranges) - set(former.ranges))
        if new:
            remedy = {name: nominal(name) for name in new}
            raise ValueError(
                "randomize must keep to the parameters that it named at construction, "
                f"{sorted(former.ranges)}, got {new} too. Build a new environment with "
                f"randomize={remedy}: such ranges leave the arm as it is until they are widened."
            )
        ranges = {name: self.ranges.get(name, nominal(name)) for name in former.ranges}
        return replace(self, ranges=ranges)


def settings(task: Task, spread: Mapping[str, Range], given: Mapping[str, Any]) -> Settings:
    """Settings from the keywords `given` to `core.Core`, in which ranges replace those of `spread`.

    `spread` has the ranges of the hardware or of the event.
    """
    reward, randomize, obs = given["reward"], given["randomize"], given["obs"]
    if isinstance(obs, str) and obs == "goal" and reward is not None:
        raise ValueError(
            f"reward ({validate.shown(reward)}) must be left out beside obs='goal', whose reward "
            "is that of compute_reward."
        )
    return Settings(
        weights=resolve_weights(task.reward if reward is None else reward),
        deflection_limit=arguments.within(
            "deflection_limit", given["deflection_limit"], *arguments.DEFLECTION_LIMITS, "-"
        ),
        max_steps=validate.integer(
            given["max_steps"], "max_episode_steps", 0, arguments.MOST_STEPS
        ),
        ranges={
            name: arguments.drawn(name, pair, f"{name} by hardware or event")
            for name, pair in spread.items()
        }
        | arguments.ranges({} if randomize is None else randomize),
    )


def nominal(name: str) -> Range:
    """Range of a free parameter that leaves the arm as it is described."""
    value = FREE_PARAMETERS[name].nominal
    return (value, value)
