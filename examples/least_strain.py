"""The torque that moves an arm from rest to rest in a given time with least strain at its roots.

    python examples/least_strain.py [--id FlexArm/TwoLink-Reach-v0] [--time 4.5] [--turn 0.5]

SciPy's SLSQP finds it by gradients through the compiled control step: every action of the move is a
variable, every coordinate and rate at its end a constraint. All derivatives come from one pass back
through a batch: each environment plays the same actions and ends in another constraint.
"""

import argparse
import time
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from scipy.optimize import minimize

import flexarm_env  # noqa: F401, registers the ids
from flexarm_env import TorchVecEnv

AFTER = 50  # control steps of zero torque, to see what still vibrates


class Move:
    """A move of all joints by `turn` [rad] in `steps` control steps.

    Constraints: at the end joints are on the target, links are straight and nothing moves.
    """

    def __init__(self, env_id: str, steps: int, turn: float, least: str) -> None:
        core = TorchVecEnv(env_id, 1).core
        n, scales = core.arm.n, core.scales
        self.steps, self.least, self.torques = steps, least, core.arm.n_torque
        self.start, self.end = np.zeros(n), np.zeros(n)
        joints = list(core.arm.joint_index)
        self.start[joints] = scales.home
        self.end[joints] = np.array(scales.home) + turn
        modes = [i for i in range(n) if i not in joints]
        units = np.ones((2, n))
        units[0, modes], units[1, modes] = scales.modal_scale, scales.modal_rate
        self._scale = torch.from_numpy(core.gauge_scale)
        self._units = torch.from_numpy(units.ravel())
        self._target = torch.from_numpy(np.concatenate([self.end, np.zeros(n)]))
        self._envs = TorchVecEnv(
            env_id, 1 + 2 * n, differentiable=True, max_episode_steps=None, deflection_limit=0.3
        )
        self.options = {"state": {"q": self.start}, "target": self.end[joints]}
        self._actions: Any = None

    def evaluate(self, actions: Any) -> None:
        """Compute the objective, the constraints and the derivatives of both."""
        if self._actions is not None and np.array_equal(actions, self._actions):
            return
        self._actions = actions.copy()
        envs = self._envs
        envs.reset(seed=0, options=self.options)
        shaped = torch.from_numpy(actions.reshape(self.steps, 1, self.torques)).float()
        given = shaped.repeat(1, envs.num_envs, 1).requires_grad_()
        strain = torch.zeros(envs.num_envs, dtype=torch.float64)
        for action in given:
            info = envs.step(action)[-1]
            strain = strain + ((info["root_curvature"] / self._scale) ** 2).sum(1)
        ends = (envs.state[: len(self._units)] - self._target[:, None]) / self._units[:, None]
        effort = (given.double() ** 2).sum((0, 2))
        objective = strain if self.least == "strain" else effort
        own = torch.diagonal(ends[:, 1:])  # constraint k of environment k + 1
        (objective[0] + own.sum()).backward()
        assert given.grad is not None
        slopes = given.grad.double().transpose(0, 1).reshape(envs.num_envs, -1).numpy()
        self.objective, self.slope = objective[0].item(), slopes[0]
        self.residual, self.slopes = own.detach().numpy(), slopes[1:]

    def solved(self) -> Any:
        """(steps, n_torque) actions of least strain or torque."""

        def of(name: str) -> Any:
            def value(actions: Any) -> Any:
                self.evaluate(actions)
                return np.copy(getattr(self, name))  # SLSQP writes into what it is given

            return value

        found = minimize(
            of("objective"),
            np.zeros(self.steps * self.torques),
            jac=of("slope"),
            bounds=[(-1.0, 1.0)] * (self.steps * self.torques),
            constraints={"type": "eq", "fun": of("residual"), "jac": of("slopes")},
            method="SLSQP",
            options={"maxiter": 200, "ftol": 1e-4},
        )
        if not found.success:
            raise SystemExit(
                f"No move of {self.steps} control steps was found ({found.message}); give it more "
                "--time or a smaller --turn."
            )
        return found.x.reshape(self.steps, self.torques)


def replayed(env_id: str, move: Move, actions: Any) -> dict[str, float]:
    """The move in the single environment, and then without torque."""
    env = gym.make(env_id, max_episode_steps=-1)
    env.reset(seed=0, options=move.options)
    coasting = np.zeros((AFTER, move.torques))
    infos = [env.step(x)[-1] for x in np.concatenate([actions, coasting]).astype(np.float32)]
    env.close()
    bent = [float(np.abs(info["root_curvature"]).max()) for info in infos]
    return {
        "largest curvature [1/m]": max(bent[: len(actions)]),
        "curvature afterwards [1/m]": max(bent[len(actions) :]),
        "tip error at the end [mm]": 1e3 * infos[len(actions) - 1]["tip_error"],
        "largest action": float(np.abs(actions).max()),
    }


def main() -> None:
    """Find the moves of least torque and of least strain, and replay both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--id", default="FlexArm/OneLink-Reach-v0")
    parser.add_argument("--time", type=float, default=1.0, help="[s] that the move takes")
    parser.add_argument("--turn", type=float, default=0.5, help="[rad] of every joint")
    arguments = parser.parse_args()
    env = gym.make(arguments.id)
    steps = round(arguments.time / env.unwrapped.control_dt)  # type: ignore[attr-defined]
    rows: dict[str, dict[str, float]] = {}
    for least in ("torque", "strain"):
        begun = time.perf_counter()
        move = Move(arguments.id, steps, arguments.turn, least)
        actions = move.solved()
        taken = {"found in [s]": time.perf_counter() - begun}
        rows[least] = replayed(arguments.id, move, actions) | taken
    table = Table("", *(f"least {name}" for name in rows))
    for quantity in rows["strain"]:
        table.add_row(escape(quantity), *(f"{row[quantity]:.2g}" for row in rows.values()))
    Console().print(table)


if __name__ == "__main__":
    main()
