"""Recurrent PPO whose updates run each sequence through the LSTM in one call."""

from typing import Any, ClassVar

import sb3_contrib
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy


class LstmPolicy(RecurrentActorCriticPolicy):
    """sb3-contrib's policy with LSTM cells, which calls them once a sequence.

    An episode can begin only at the first step of a sequence of the rollout, so states are reset
    before it; sb3-contrib calls the cells once a step to reset them anywhere.
    """

    @staticmethod
    def _process_sequence(features: Any, lstm_states: Any, episode_starts: Any, lstm: Any) -> Any:
        sequences = lstm_states[0].shape[1]
        starts = episode_starts.reshape(sequences, -1)
        if starts[:, 1:].any():
            return RecurrentActorCriticPolicy._process_sequence(
                features, lstm_states, episode_starts, lstm
            )
        kept = (1.0 - starts[:, 0]).view(1, sequences, 1)
        steps = features.reshape(sequences, -1, lstm.input_size).swapaxes(0, 1)
        output, states = lstm(steps, tuple(kept * state for state in lstm_states))
        return output.transpose(0, 1).flatten(0, 1), states


class RecurrentPPO(sb3_contrib.RecurrentPPO):
    """sb3-contrib's recurrent PPO with the faster policy."""

    policy_aliases: ClassVar[dict[str, Any]] = {"MlpLstmPolicy": LstmPolicy}
