"""Augmented random search whose training can be watched and resumed."""

from typing import Any

import sb3_contrib


class ARS(sb3_contrib.ARS):
    """sb3-contrib's ARS with its steps shown to the callback and its weights in checkpoints."""

    def _trigger_callback(self, _locals: Any, _globals: Any, callback: Any, n_envs: int) -> None:
        callback.update_locals(_locals)  # rewards, dones and infos of the step
        super()._trigger_callback(_locals, _globals, callback, n_envs)

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        modules, tensors = super()._get_torch_save_params()
        return modules, [*tensors, "weights"]
