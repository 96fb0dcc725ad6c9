"""One trial of a sweep: an experiment trained in a Ray worker, with reports and checkpoints."""

import tempfile
from pathlib import Path
from typing import Any

from agents.config import config_from_dict
from agents.learners.divergence import TrainingError, divergence_told
from agents.learners.export import export_policy
from agents.policy import save_policy
from agents.run_folder.checkpoints import newest_intact, restore_checkpoint, save_checkpoint
from agents.training import about_policy, begin_warm, build_model
from agents.tune.learners import LOST, judged

REPORTS = 9  # of a trial that is not stopped early
EPISODES = 32  # judged at every report, other ones than those of an evaluation
POLICY = "policy"  # folder in a checkpoint
DIVERGED = "diverged"  # in the last report of a trial whose weights are not finite


def train_trial(settings: dict[str, Any]) -> None:
    """Train the experiment of `settings["planned"]`, from an intact checkpoint if there is one.

    Reports the mean score of the tuning episodes, the objective by which trials are ranked, the
    steps, how often the trial was restarted, and Ray's name of the machine, each time with a
    checkpoint. A trial that diverges ends with a report that says so.
    """
    import ray
    from ray import tune
    from stable_baselines3.common.callbacks import BaseCallback

    config = config_from_dict(settings["planned"]["experiment"])
    model, about = build_model(config), about_policy(config)
    progress = {"session": 0, "seconds": 0.0}
    checkpoint, found = tune.get_checkpoint(), None
    if checkpoint is not None:
        with checkpoint.as_directory() as folder:
            found, _ = newest_intact(Path(folder))
            if found is not None:
                progress = restore_checkpoint(model, found)
                progress["session"] += 1
    if found is None:
        begin_warm(model, config)
    node = ray.get_runtime_context().get_node_id()
    interval = -(-config.total_steps // REPORTS)

    def place() -> dict[str, Any]:
        return {"steps": model.num_timesteps, "restarts": progress["session"], "node": node}

    def report() -> None:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            save_checkpoint(model, folder, progress)
            policy = export_policy(model, about | {"steps": model.num_timesteps})
            save_policy(policy, folder / POLICY)
            entry = judged(config, policy, EPISODES) | place()
            tune.report(entry, checkpoint=tune.Checkpoint.from_directory(folder))

    class Reports(BaseCallback):
        def _on_training_start(self) -> None:
            self.due = (self.num_timesteps // interval + 1) * interval

        def _on_step(self) -> bool:
            return True

        def _on_rollout_start(self) -> None:  # between updates: the state is consistent here
            if self.due <= self.num_timesteps < config.total_steps:
                self.due += interval
                report()

    remaining = config.total_steps - model.num_timesteps
    try:
        with divergence_told(model):
            if remaining > 0:
                fresh = found is None
                model.learn(remaining, Reports(), log_interval=None, reset_num_timesteps=fresh)
    except TrainingError:  # as it would again from its checkpoint
        tune.report(LOST | {DIVERGED: True} | place())
    else:
        report()
    model.env.close()
