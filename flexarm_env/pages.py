"""One page per environment, made from the code: `python -m flexarm_env.pages --out docs/envs`."""

import argparse
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.simulation.validity import LARGEST_RATE
from flexarm_env.accuracy.certificates import kept
from flexarm_env.certify import EPISODES, TIP_ERROR
from flexarm_env.compiled.signals import LOST
from flexarm_env.core import Core
from flexarm_env.env import FlexArmEnv
from flexarm_env.observations import Layout
from flexarm_env.registration import IDS
from flexarm_env.rewards import REWARDS, TERMS
from flexarm_env.scales import DEFLECTION_LIMIT, SLOPE_PER_DEFLECTION
from flexarm_env.tasks import SETTLED_BAND, TASKS

ARGUMENTS = (
    ("arm", "the id's", "preset name, path to an arm file (.json, .yaml), dict or `Arm`"),
    ("obs", '"state"', '"state", or "sensors": encoders, joint rates, strain gauges'),
    ("reward", "the task's", "a preset's name or a dict of weights of the terms below"),
    ("control_dt", "the id's", "[s] time between actions"),
    (
        "integrator",
        "None",
        "a method of `dynamics.integrators.INTEGRATORS`; None: the one with the "
        "fewest evaluations that keeps the tip within 1e-3 of the reach",
    ),
    ("substeps", "None", "integration steps per control step; None: chosen for the arm"),
    ("torque_limit", "None", "[N m] one number or one per joint; None: chosen for the arm"),
    ("deflection_limit", str(DEFLECTION_LIMIT), "[-] deflection over length that ends an episode"),
    ("render_mode", "None", '"rgb_array" or "human"'),
    ("threads", "1", "worker threads at most, `gym.make_vec` only"),
    ("fidelity", '"auto"', '"auto", the arm as described; "rigid"; or "reference", fine and slow'),
    (
        "tolerance",
        "None",
        "[m] instead: the cheapest model, integrator and step within it on "
        "motions as hard as the torque limits allow; found once, then kept",
    ),
    ("dtype", '"float64"', 'number type of the compiled code: "float64" or "float32"'),
    (
        "randomize",
        "None",
        "ranges (low, high) of `payload_mass` [kg] and of factors of "
        "`stiffness`, `damping` and `friction`, drawn at every reset: a dict",
    ),
)


def page(env_id: str) -> str:
    """The page of one id, as Markdown."""
    env = gym.make(env_id).unwrapped
    assert isinstance(env, FlexArmEnv)
    core = env.core
    steps = IDS[env_id]["max_episode_steps"]
    task, arm = core.task, core.arm
    sections = [
        f"# {env_id}",
        f"{arm.name}: {task.title}. {task.description}\n\n{arm.description}",
        "```python\nimport gymnasium as gym\nimport flexarm_env\n\n"
        f'env = gym.make("{env_id}")\nenvs = gym.make_vec("{env_id}", num_envs=1024)\n```',
        _facts(core, steps),
        "## Accuracy\n\n" + _accuracy(core),
        "## Actions\n\n" + _actions(core),
        "## Observations\n\n" + _observations("state", env_id),
        '### With `obs="sensors"`\n\n' + _observations("sensors", env_id),
        "## Rewards\n\n" + _rewards(core),
        f"## Starting state\n\n{task.start_text}\n\nHome posture [rad]: "
        f"{_numbers(core.scales.home)}. `reset(options=...)` takes `state` (a dict of "
        f"`q` and `v`, {arm.n} numbers each: {', '.join(arm.names)}) and `target` "
        f"({arm.n_joint} joint angles).",
        "## Episode end\n\n" + _end(steps, core),
        "## Info\n\n" + _info(),
        "## Arguments\n\n" + _table(("keyword", "default", "meaning"), ARGUMENTS),
        "## Version history\n\n- v0: first version.",
    ]
    env.close()
    return "\n\n".join(sections) + "\n"


def _facts(core: Core, steps: int) -> str:
    rows = [
        ("links, coordinates", f"{core.arm.n_joint}, {core.arm.n}"),
        ("reach", f"{core.arm.reach:.4g} m"),
        ("control step, episode", f"{core.control_dt:g} s, {steps} steps"),
        ("integration", f"{core.integrator}, {core.substeps} steps per control step"),
        ("first frequencies, joints held", f"{_numbers(_hertz(core.scales.held[:2]))} Hz"),
        ("first frequencies, joints free", f"{_numbers(_hertz(core.scales.free[:2]))} Hz"),
        ("a typical move (0.5 rad, bang-bang)", f"{core.move_time:.2f} s"),
    ]
    return _table(("", ""), rows)


def _accuracy(core: Core) -> str:
    """The certificate as a table."""
    c = core.certificate
    assert c is not None, "A registered environment is certified: see certificates.py."
    meanings = {
        "error": "in all, from the reference",
        "integration": "of the step alone",
        "truncation": "of the modes kept, from more of them",
        "nonlinear": "of a linear model with those, from the reference",
        "residual": "of the reference: what its last refinement changed",
    }
    if core.arm.foreshortening:
        meanings["nonlinear"] = "of a foreshortened model with those, from the reference"
    rows = [
        (key, text, f"{1e3 * c[key]:.2g} mm", f"{c[key] / c['reach']:.1e}")
        for key, text in meanings.items()
    ]
    return (
        f"Largest tip error on motions as hard as the torque limits allow ({c['scene']}), measured "
        f"by `{c['reproduce']}` and kept as `env.unwrapped.certificate`:\n\n"
        + _table(("part", "meaning", "tip error", "of the reach"), rows)
        + f"\n\nModel: {c['model']}. Reference: {c['reference']}. Gentler motions err less; "
        "`tolerance=` chooses another model.\n\n" + _steps(core)
    )


def _steps(core: Core) -> str:
    """How the step was chosen, as a table."""
    entry = kept(core.arm, core.control_dt)
    assert entry is not None
    rows = [
        (
            step["integrator"],
            str(step["substeps"]),
            f"{step['error']:.1e}",
            f"{1e6 * step['seconds']:.2g} us",
        )
        for step in entry["steps"]
    ]
    head = ("integrator", "steps per control step", "tip error, of the reach", "time")
    return (
        f"The step is the first of these: of each method the fewest that keep the tip within "
        f"{TIP_ERROR:g} of the reach through {EPISODES} episodes of random torques; the time is "
        "that of one environment in a batch, per control step, on the machine that measured.\n\n"
        + _table(head, rows)
    )


def _actions(core: Core) -> str:
    rows = [
        (str(j), f"torque of joint {j + 1}", "-1", "1", f"{limit:g} N m")
        for j, limit in enumerate(core.torque_limit)
    ]
    space = f"`Box(-1, 1, ({core.arm.n_joint},), float32)`; values beyond are clipped.\n\n"
    rule = (
        "\n\nThe limits give every joint the same acceleration, as large as one period of "
        "bang-bang at the first joint-free frequency, of all joints at once, stays inside the "
        "model's validity."
    )
    return space + _table(("index", "action", "min", "max", "1 means"), rows) + rule


def _observations(kind: str, env_id: str) -> str:
    env = gym.make(env_id, obs=kind).unwrapped
    assert isinstance(env, FlexArmEnv)
    layout: Layout = env.core.layout
    rows = []
    for part in layout.parts:
        start = layout.slices[part.name].start
        for k, scale in enumerate(part.scale):
            name = f"`{part.name}`" + (f" {k + 1}" if len(part.scale) > 1 else "")
            bound = f"{part.bound:g}"
            one = f"{scale:.4g} {part.unit}" if part.unit != "-" else f"{scale:g}"
            rows.append((str(start + k), name, part.meaning, f"-{bound}", bound, one))
    space = f"`Box({env.observation_space.shape}, float32)`, clipped to its bounds.\n\n"
    return space + _table(("index", "name", "meaning", "min", "max", "1 means"), rows)


def _rewards(core: Core) -> str:
    weights = REWARDS[core.task.reward]
    rows = [
        (f"`{name}`", " ".join((term.__doc__ or "").split()), f"{weights.get(name, 0.0):g}")
        for name, term in TERMS.items()
    ]
    text = (
        f'The sum of weight times term; default weights are the preset "{core.task.reward}". '
        "Goals lie in [0, 1], costs are at most 0. Speeds are counted in those of a typical move "
        f"({core.rate_scale:.3g} rad/s at a joint, {core.arm.reach * core.rate_scale:.3g} m/s at "
        f"the tip). Other presets: {', '.join(sorted(set(REWARDS) - {core.task.reward}))}.\n\n"
    )
    return text + _table(("term", "meaning", "weight"), rows)


def _end(steps: int, core: Core) -> str:
    limit = SLOPE_PER_DEFLECTION * DEFLECTION_LIMIT
    return (
        f"- terminated, `info['invalid']`: a link deflects by more than {DEFLECTION_LIMIT:.0%} of "
        f"its length, or its tip turns by more than {limit:.2g} rad (what the first shape of a "
        "beam on a light hub does at that deflection).\n"
        "- terminated, `info['diverged']`: the state is not finite, or a deflection is "
        f"{LOST:g} times that limit; the last finite state is reported.\n"
        f"- truncated after {steps} steps ({steps * core.control_dt:g} s)."
    )


def _info() -> str:
    rows = [
        ("time", "s", "since the start of the episode"),
        ("tip_error", "m", "distance from tip to target"),
        ("tip_speed", "m/s", "speed of the tip relative to the target"),
        ("deflection", "-", "largest deflection of a link over its length"),
        ("tip_deflection", "m", "distance from the tip to that of the straight-link arm"),
        ("root_curvature", "1/m", "at the root of each link, per bending plane"),
        ("torque", "N m", "applied in the step"),
        ("reward_terms", "-", "every term by name"),
        ("settled", "-", f"tip error below {SETTLED_BAND:.0%} of the reach"),
        ("diverged, invalid", "-", "see above"),
        (
            "overspeed",
            "-",
            f"a joint turns faster than {LARGEST_RATE:g} of the first frequency of the held arm: "
            "linear modes lose stiffness there; never set with foreshortening",
        ),
    ]
    return _table(("key", "unit", "meaning"), [(f"`{key}`", *rest) for key, *rest in rows])


def _table(head: tuple[str, ...], rows: Any) -> str:
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def _hertz(frequencies: tuple[float, ...]) -> Any:
    return np.array(frequencies) / (2.0 * np.pi)


def _numbers(values: Any) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def file_name(env_id: str) -> str:
    """one-link-reach-v0.md and the like."""
    return env_id.split("/")[1].replace("Link", "-Link").lower() + ".md"


def index() -> str:
    """The list of the pages."""
    rows = [
        (f"[{env_id}]({file_name(env_id)})", spec["kwargs"]["arm"],
         TASKS[spec["kwargs"]["task"]].title)
        for env_id, spec in IDS.items()
    ]  # fmt: skip
    return "# Environments\n\n" + _table(("id", "arm", "task"), rows) + "\n"


def main() -> None:
    """Write all pages into a folder."""
    parser = argparse.ArgumentParser(description="Write one page per environment.")
    parser.add_argument("--out", type=Path, default=Path("docs/envs"))
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    for env_id in IDS:
        (folder / file_name(env_id)).write_text(page(env_id), encoding="utf-8")
    (folder / "README.md").write_text(index(), encoding="utf-8")


if __name__ == "__main__":
    main()
