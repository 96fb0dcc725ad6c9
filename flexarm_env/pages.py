"""Pages of the environments: `python -m flexarm_env.pages --out docs/envs`.

`common_page` is README.md, with the rules and definitions that hold for every id; `page` has the
numbers of one id.
"""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.load import load_arm
from dynamics.simulation.validity import LARGEST_RATE
from flexarm_env.accuracy.certificates import AUTO_TOLERANCE, kept
from flexarm_env.accuracy.table import CERTIFICATE, accuracy
from flexarm_env.accuracy.table import markdown as _table
from flexarm_env.certify import BATCH, EPISODE_ERROR, EPISODES, TIP_ERROR
from flexarm_env.compiled.termination import LOST
from flexarm_env.core import Core
from flexarm_env.env import FlexArmEnv
from flexarm_env.observations import BOUND, MODES, Part, observation_layout
from flexarm_env.registration import IDS
from flexarm_env.rewards import REWARDS, TERMS
from flexarm_env.scales import DEFLECTION_LIMIT, MOVE, SLOPE_PER_DEFLECTION, scales
from flexarm_env.tasks import SETTLED_BAND, TASKS

COMMON = """\
# Environments

{ids}

The page of an id has its numbers. This page has the rules that all ids share.

## Use

```python
import gymnasium as gym
import flexarm_env  # registers the ids

env = gym.make("FlexArm/OneLink-Reach-v0")  # one environment
envs = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=1024)  # a batch, stepped in one call
sb3_envs = flexarm_env.SB3VecEnv("FlexArm/OneLink-Reach-v0", 1024)  # for stable-baselines3
```

Environment i of a batch with `seed=s` is the single environment with seed s + i. All quantities are
in SI units. `env.unwrapped` has the attributes `arm`, `model`, `task`, `control_dt`,
`torque_limit`, `n_joint`, `reach`, `certificate`, `observation_slices` and `observation_scales`,
and the methods `joint_target()` and `joint_state()`. An id never changes its dynamics, observations
or rewards: a change gets a new version. All ids are at v0, the first.

## Definitions

{terms}

## Actions

`Box(-1, 1, (n_joint,), float32)`: torque of each joint over its torque limit, clipped to [-1, 1]
and constant over a control step. Numbers that are not finite are refused.

## Observations

`Box((n,), float32)`: each element is a quantity over its scale, clipped to [-{bound:g}, {bound:g}];
sine, cosine and action to [-1, 1].

{observations}

## Rewards

The reward is the sum of weight times term. Goals lie in [0, 1], costs are at most 0. Joint rates
are in units of the rate scale, tip speeds (relative to the target) in units of the speed scale. The
columns are the presets of `reward=`; a dict sets other weights.

{rewards}

## Reset

`reset(seed=..., options=...)` draws the start of the task, except where `options` sets `state`, a
dict of `q` and `v` (one number per coordinate; zeros if left out), or `target`, joint angles. In a
batch, options may have one row per environment.

## Termination and truncation

- Terminated, `info["invalid"]`: a link deflects by more than {deflection:.0%} of its length, or
  its tip turns by more than {slope:.2g} rad (the slope of the first shape of a beam on a light hub
  at that deflection).
- Terminated, `info["diverged"]`: a deflection exceeds {lost:g} times that limit, or the state is
  not finite or too large. In the second case observation and info show the state before the step.
- Truncated: the episode has the number of steps on the page of the id.

## Info

{info}

## Keywords

{keywords}

## Accuracy

The certificate of an id (`env.unwrapped.certificate`) has the largest tip error on two motions from
rest at the home posture: bang-bang at full torque in all joints, then coasting; and random torques,
each constant over a control step. Gentler motions have smaller errors. The reference is a
foreshortened model in segments, refined until its tip converges. The rich model is the model of the
id with five bending modes per direction and three torsion modes per link.

{certificate}

Model and step of an id are the cheapest for an error of {tip_error:g} of the reach in all, model
and step together, on these motions: `dynamics.choose_model` finds the model, and for each
integrator the fewest substeps are listed. The environment uses the first row of its table of steps.
It has the least CPU time, where a tenth more time is accepted for a tenth of the error. CPU time is
per control step of one environment in a batch of {batch}, on the machine that measured. The step's
error differs between starts: the table also has the largest of {episodes} episodes each of Reach,
from rest, and of Damp, with links that vibrate, all as long as the certificate's random torques and
by the step alone. Methods above {episode_error:g} of the reach there are left out.
`python -m flexarm_env.certify` measures all of this again.
"""

TERMINOLOGY = (
    (
        "coordinates q",
        "joint angles `q1`, ... [rad]; modal amplitudes `d1_1`, ... [m] of link 1, ...",
    ),
    ("straight-link arm", "the arm at its joint angles with all modal amplitudes zero"),
    ("target", "tip of the straight-link arm at the target joint angles"),
    ("reach", "length of the stretched arm"),
    ("locked, free frequencies", "natural frequencies with the joints locked or free"),
    (
        "bang-bang test",
        "all joints take full torque for half a period of the first free frequency, the opposite "
        "torque for the other half, then none",
    ),
    (
        "torque limit",
        "torque that gives each joint the same acceleration, the largest for which the model stays "
        "valid in the bang-bang test; rounded down to two digits",
    ),
    ("angle scale", f"{MOVE:g} rad"),
    ("rate scale", "peak joint rate of a bang-bang move by the angle scale at full torque [rad/s]"),
    ("move time", "duration of this move [s]"),
    ("speed scale", "reach times rate scale [m/s]"),
    ("modal scales", "peaks of modal amplitudes [m] and modal rates [m/s] in the bang-bang test"),
    ("settled", f"tip error below {SETTLED_BAND:.0%} of the reach"),
)

PRESENT = {  # observation: (scale, where it is present); its meaning comes from the layout
    "joint_error": ("angle scale", "always"),
    "joint_sin": ("1", "joint 2 and later; joint 1 only under gravity"),
    "joint_cos": ("1", "as `joint_sin`"),
    "joint_rate": ("rate scale", "always"),
    "modal_amplitude": ("modal scale", '`obs="state"`'),
    "modal_rate": ("modal scale", '`obs="state"`'),
    "tip_error": (f"{MOVE:g} reach", '`obs="state"`; directions in which it can differ from zero'),
    "root_curvature": ("that of a tip force at 10 % deflection", '`obs="sensors"`'),
    "target_rate": ("rate scale", "task Track"),
    "target_near": ("angle scale", "task Track"),
    "target_far": ("angle scale", "task Track"),
    "joint_torque": ("torque limit", "with `actuator`"),
    "last_action": ("1", "always"),
}

INFO = (
    ("time", "s", "since the start of the episode"),
    ("tip_error", "m", "distance from tip to target"),
    ("tip_speed", "m/s", "speed of the tip relative to the target"),
    ("deflection", "-", "largest deflection of a link over its length"),
    ("tip_deflection", "m", "distance from the tip to the tip of the straight-link arm"),
    ("root_curvature", "1/m", "at the root of each link, per bending direction"),
    ("torque", "N m", "at the joints, at the end of the step"),
    ("command", "V or N m", "command of the action, with `actuator` only"),
    ("reward_terms", "-", "dict of all reward terms"),
    ("settled", "-", "whether the tip error is in the settled band"),
    ("invalid", "-", "whether a link bends beyond its limit, see above"),
    ("diverged", "-", "whether the state diverged, see above"),
    (
        "overspeed",
        "-",
        f"whether a joint turns faster than {LARGEST_RATE:g} of the first locked frequency, where "
        "linear modes lose stiffness; never with foreshortening",
    ),
)

KEYWORDS = (
    ("arm", "the id's",
     "preset name, path to an arm file (.json, .yaml), dict or `Arm`; an arm with `modes: auto` "
     f"takes the cheapest model within {AUTO_TOLERANCE:g} of the reach, as by `tolerance`"),
    ("obs", '"state"', '"state", or "sensors": encoders, joint rates, strain gauges'),
    ("reward", "the task's", "preset name or a dict of weights of reward terms"),
    ("control_dt", "the id's", "[s] time between actions"),
    ("integrator", "None",
     "a method of `dynamics.integrators.table.INTEGRATORS`; None: the measured best; for an arm "
     "that was not measured, by rule the fewest evaluations for an error of 1e-3 of the reach"),
    ("substeps", "None", "integration steps per control step; None: chosen with the integrator"),
    ("torque_limit", "None", "[N m] one number or one per joint; None: as defined above"),
    ("actuator", "None", "[actuators](../actuators.md) between action and torque; None: ideal"),
    ("deflection_limit", str(DEFLECTION_LIMIT), "[-] deflection over length that ends an episode"),
    ("render_mode", "None", '"rgb_array" or "human"'),
    ("threads", "1", "largest number of worker threads, `gym.make_vec` only"),
    ("fidelity", '"auto"',
     '"auto", the arm as described; "rigid"; or "reference", fine segments and slow'),
    ("tolerance", "None",
     "[m] replaces `fidelity`: the cheapest model, integrator and step with a smaller tip error "
     "on the motions of the certificate; searched once, then cached"),
    ("dtype", '"float64"', 'number type of the compiled code: "float64" or "float32"'),
    ("randomize", "None",
     "dict of ranges (low, high) of `payload_mass` [kg] and of factors on `stiffness`, "
     "`damping` and `friction`, drawn at every reset"),
)  # fmt: skip


def common_page() -> str:
    """README.md: the list of ids, and all that they have in common."""
    return COMMON.format(
        ids=_table(("id", "arm", "task"), _ids()),
        terms=_table(("term", "meaning"), TERMINOLOGY),
        bound=BOUND,
        observations=_table(("name", "meaning", "unit", "scale", "present"), _observation_names()),
        rewards=_table(("term", "meaning", *(f"`{name}`" for name in REWARDS)), _reward_terms()),
        deflection=DEFLECTION_LIMIT,
        slope=SLOPE_PER_DEFLECTION * DEFLECTION_LIMIT,
        lost=LOST,
        info=_table(("key", "unit", "meaning"), _code_first(INFO)),
        keywords=_table(("keyword", "default", "meaning"), _code_first(KEYWORDS)),
        certificate=_table(("error", "of"), _code_first(CERTIFICATE)),
        tip_error=TIP_ERROR,
        episodes=EPISODES,
        episode_error=EPISODE_ERROR,
        batch=BATCH,
    )


def page(env_id: str) -> str:
    """Page of one id."""
    env = gym.make(env_id).unwrapped
    assert isinstance(env, FlexArmEnv)
    core = env.core
    weights = REWARDS[core.task.reward]
    reward = " + ".join(f"{weight:g} {name}" for name, weight in weights.items())
    sections = [
        f"# {env_id}",
        f"{core.arm.name}: {core.task.title}. {core.task.description}\n\n{core.arm.description}",
        "[Environments](README.md) defines the terms, actions, info, episode ends and keywords.",
        _facts(core, IDS[env_id]["max_episode_steps"]),
        f"**Start.** {core.task.start_text}",
        f"**Reward.** Preset `{core.task.reward}`: {reward}.",
        *(f'## Observations with `obs="{kind}"`\n\n' + _elements(env_id, kind) for kind in MODES),
        "## Accuracy\n\n" + _accuracy(core),
    ]
    env.close()
    return "\n\n".join(sections) + "\n"


# ---- tables of the common page ------------------------------------------------------------------


def _ids() -> list[Sequence[str]]:
    return [
        (f"[{env_id}]({file_name(env_id)})", spec["kwargs"]["arm"],
         TASKS[spec["kwargs"]["task"]].title)
        for env_id, spec in IDS.items()
    ]  # fmt: skip


def _observation_names() -> list[Sequence[str]]:
    """Every name that an observation can have, from the layouts of an arm with all of them."""
    arm = load_arm("six-link")
    parts: dict[str, Part] = {}
    for kind in MODES:
        torques = (1.0,) * arm.n_joint
        layout = observation_layout(arm, TASKS["Track"], kind, scales(arm), 1.0, torques)
        parts |= {part.name: part for part in layout.parts}
    return [
        (f"`{name}`", parts[name].meaning, parts[name].unit, scale, present)
        for name, (scale, present) in PRESENT.items()
    ]


def _reward_terms() -> list[Sequence[str]]:
    return [
        (f"`{name}`", " ".join((term.__doc__ or "").split()),
         *(f"{weights[name]:g}" if name in weights else "" for weights in REWARDS.values()))
        for name, term in TERMS.items()
    ]  # fmt: skip


# ---- sections of an id's page -------------------------------------------------------------------


def _facts(core: Core, steps: int) -> str:
    arm = core.arm
    locked, free = (np.array(x[:2]) / (2.0 * np.pi) for x in (core.scales.locked, core.scales.free))
    rows = [
        ("coordinates", f"{arm.n}: {', '.join(arm.names)}"),
        ("home posture", f"{_numbers(core.scales.home)} rad"),
        ("reach", f"{arm.reach:.4g} m"),
        ("torque limits", f"{_numbers(core.torque_limit)} N m"),
        ("control step", f"{core.control_dt:g} s"),
        ("episode", f"{steps} steps, {steps * core.control_dt:g} s"),
        ("integration", f"{core.integrator}, {_counted(core.substeps, 'step')} per control step"),
        ("first locked frequencies", f"{_numbers(locked)} Hz"),
        ("first free frequencies", f"{_numbers(free)} Hz"),
        ("move time", f"{core.move_time:.2f} s"),
        ("rate scale", f"{core.rate_scale:.3g} rad/s"),
        ("speed scale", f"{arm.reach * core.rate_scale:.3g} m/s"),
    ]
    return _table(("", ""), rows)


def _elements(env_id: str, kind: str) -> str:
    """Elements of an observation, one row per name."""
    env = gym.make(env_id, obs=kind).unwrapped
    assert isinstance(env, FlexArmEnv)
    layout, rows = env.core.layout, []
    for part in layout.parts:
        at = layout.slices[part.name]
        index = f"{at.start}" if at.stop == at.start + 1 else f"{at.start} to {at.stop - 1}"
        scale = part.scale[:1] if len(set(part.scale)) == 1 else part.scale
        unit = "" if part.unit == "-" else f" {part.unit}"
        rows.append((index, f"`{part.name}`", _components(env.core, part), _numbers(scale) + unit))
    env.close()
    return f"{layout.size} elements.\n\n" + _table(("index", "name", "of", "scale"), rows)


def _components(core: Core, part: Part) -> str:
    """The joints, coordinates, directions or strain gauges of the elements of a part."""
    if part.name.startswith("modal"):
        return ", ".join(core.arm.names[k] for k in part.entries)
    if part.name == "tip_error":
        return ", ".join("xyz"[k] for k in part.entries)
    if part.name == "root_curvature":
        return ", ".join(f"link {k // 2 + 1} {'yz'[k % 2]}" for k in part.entries)
    first, last = part.entries[0] + 1, part.entries[-1] + 1
    return f"joint {first}" if first == last else f"joints {first} to {last}"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def _accuracy(core: Core) -> str:
    """Certificate and measured steps."""
    c, entry = core.certificate, kept(core.arm, core.control_dt)
    assert c is not None, "A registered environment is certified: see certificates.py."
    assert entry is not None
    return accuracy(c, entry["steps"])


# ---- text ---------------------------------------------------------------------------------------


def _code_first(rows: Iterable[Sequence[str]]) -> list[Sequence[str]]:
    """Rows with their first entry as code."""
    return [(f"`{first}`", *rest) for first, *rest in rows]


def _numbers(values: Any) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


def file_name(env_id: str) -> str:
    """File name of an id's page, such as one-link-reach-v0.md."""
    return env_id.split("/")[1].replace("Link", "-Link").lower() + ".md"


def main() -> None:
    """Write all pages into a folder."""
    parser = argparse.ArgumentParser(description="Write the pages of the environments.")
    parser.add_argument("--out", type=Path, default=Path("docs/envs"))
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    for env_id in IDS:
        (folder / file_name(env_id)).write_text(page(env_id), encoding="utf-8")
    (folder / "README.md").write_text(common_page(), encoding="utf-8")


if __name__ == "__main__":
    main()
