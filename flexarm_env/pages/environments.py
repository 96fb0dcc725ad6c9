"""Pages of the environments: `python -m flexarm_env.pages --out docs/envs`.

`common_page` is README.md, with the rules and definitions that hold for every id; `page` has the
numbers of one id.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from dynamics.load import load_arm
from flexarm_env.accuracy.certificates import covering, entries
from flexarm_env.accuracy.motions import KINDS
from flexarm_env.accuracy.table import CERTIFICATE, accuracy, kinds, sentence, steps, table
from flexarm_env.certify.certificate import DISTURBANCE
from flexarm_env.certify.certificate import EPISODES as COUNT
from flexarm_env.certify.run import FROZEN, command
from flexarm_env.certify.search import BATCH, MOMENTUM_ERROR, PARTED, SHAKEN, SLACK, TIP_ERROR
from flexarm_env.compiled.termination import LOST
from flexarm_env.core import Core
from flexarm_env.hardware.sensors import PRESETS
from flexarm_env.interfaces.env import FlexArmEnv
from flexarm_env.pages.text import COMMON, HARDWARE, INFO, KEYWORDS, PRESENT, TERMINOLOGY
from flexarm_env.registration import IDS, is_harder, without_variant
from flexarm_env.task.events import EVENTS, TIME
from flexarm_env.task.observations import BOUND, GOALS, MODES, Part, observation_layout
from flexarm_env.task.rewards import REWARDS, TERMS
from flexarm_env.task.scales import DEFLECTION_LIMIT, SLOPE_PER_DEFLECTION, scales
from flexarm_env.task.tasks import TASKS


def common_page() -> str:
    """README.md: the list of ids, and all that they have in common."""
    return COMMON.format(
        ids=table(("id", "arm", "task", "keywords"), _ids()),
        terms=table(("term", "meaning"), TERMINOLOGY),
        bound=BOUND,
        observations=table(("name", "meaning", "unit", "scale", "present"), _observation_names()),
        rewards=table(("term", "meaning", *(f"`{name}`" for name in REWARDS)), _reward_terms()),
        deflection=DEFLECTION_LIMIT,
        slope=SLOPE_PER_DEFLECTION * DEFLECTION_LIMIT,
        lost=LOST,
        info=table(("key", "unit", "meaning"), _code_first(INFO)),
        keywords=table(("keyword", "default", "meaning"), _code_first(KEYWORDS)),
        events=table(("event", "meaning"), _code_first((k, x.text) for k, x in EVENTS.items())),
        earliest=TIME[0],
        latest=TIME[1],
        hardware=table(("field", "laboratory", "meaning"), _hardware()),
        certificate=table(("error", "of"), _code_first(CERTIFICATE)),
        tip_error=TIP_ERROR,
        count=COUNT,
        kinds=table(("kind", "actions"), [(name, kind.text) for name, kind in KINDS.items()]),
        disturbance=DISTURBANCE,
        slack=SLACK,
        parted=PARTED,
        shaken=SHAKEN,
        momentum_error=MOMENTUM_ERROR,
        batch=BATCH,
    )


def page(env_id: str) -> str:
    """Page of one id."""
    env = gym.make(env_id).unwrapped
    assert isinstance(env, FlexArmEnv)
    core = env.core
    weights = REWARDS[core.task.reward]
    reward = " + ".join(f"{weight:g} {name}" for name, weight in weights.items())
    reward = f"Preset `{core.task.reward}`: {reward}."
    if core.layout.goal:
        reward = "That of `compute_reward`: 1 if settled, else 0."
    sections = [
        f"# {env_id}",
        f"{core.arm.name}: {core.task.title}. {core.task.description}\n\n{core.arm.description}",
        _film(env_id),
        "[Environments](README.md) defines the terms, actions, info, episode ends and keywords.",
        _facts(core, IDS[env_id]),
        f"**Start.** {core.task.start_text}{_floating(core)}",
        *_event(core),
        f"**Reward.** {reward}",
        *(
            f'## Observations with `obs="{kind}"`\n\n' + _elements(env_id, kind)
            for kind in (["goal"] if core.layout.goal else ["state", "sensors"])
        ),
        "## Accuracy\n\n" + _accuracy(env_id, core),
    ]
    env.close()
    return "\n\n".join(sections) + "\n"


# ---- tables of the common page ------------------------------------------------------------------


def _ids() -> list[Sequence[str]]:
    return [
        (f"[{env_id}]({file_name(env_id)})", spec["kwargs"]["arm"],
         TASKS[spec["kwargs"]["task"]].title, _further(spec["kwargs"]))
        for env_id, spec in IDS.items()
    ]  # fmt: skip


def _further(keywords: Mapping[str, Any]) -> str:
    """Keywords of an id beside those of its scene and task."""
    usual = ("task", "arm", "control_dt")
    return ", ".join(f"`{name}={value!r}`" for name, value in keywords.items() if name not in usual)


def _observation_names() -> list[Sequence[str]]:
    """Every name that an observation can have, from the layouts of arms with all of them."""
    parts: dict[str, Part] = {}
    for arm in map(load_arm, ("six-link", "free-flyer")):
        torques = (1.0,) * arm.n_joint
        for kind in MODES:
            task = TASKS["Reach" if kind == "goal" else "Track"]
            layout = observation_layout(arm, task, kind, scales(arm), 1.0, torques, True)
            parts = {part.name: part for part in layout.parts} | parts
    return [
        (f"`{name}`", parts[name].meaning, parts[name].unit, scale, present)
        for name, (scale, present) in PRESENT.items()
    ]


def _hardware() -> list[Sequence[str]]:
    laboratory = PRESETS["laboratory"]
    return [(f"`{name}`", f"{getattr(laboratory, name)}", text) for name, text in HARDWARE]


def _reward_terms() -> list[Sequence[str]]:
    return [
        (f"`{name}`", " ".join((term.__doc__ or "").split()),
         *(f"{weights[name]:g}" if name in weights else "" for weights in REWARDS.values()))
        for name, term in TERMS.items()
    ]  # fmt: skip


# ---- sections of an id's page -------------------------------------------------------------------


def _film(env_id: str) -> str:
    """Film of a good controller; see `filmed`."""
    plain = filmed(env_id)
    return (
        f"![One episode of {plain}](films/{film_name(plain)})\n\n"
        "One episode under the best controller of the [ranking](../leaderboard.md) on exact "
        "states, or joint PD where none is ranked; its name is in the corner. "
        f"`python -m agents.films {plain}` makes the film."
    )


def _facts(core: Core, spec: Mapping[str, Any]) -> str:
    arm, steps, solved = core.arm, spec["max_episode_steps"], spec["reward_threshold"]
    locked, free = (np.array(x[:2]) / (2.0 * np.pi) for x in (core.scales.locked, core.scales.free))
    rows = [
        ("coordinates", f"{arm.n}: {', '.join(arm.names)}"),
        ("home posture", f"{_numbers(core.scales.home)} rad"),
        ("reach", f"{arm.reach:.4g} m"),
        ("torque limits", f"{_numbers(core.torque_limit)} N m"),
        ("control step", f"{core.control_dt:g} s"),
        ("episode", f"{steps} steps, {steps * core.control_dt:g} s"),
        ("return of a solved episode", "not set" if solved is None else f"{solved:g}"),
        ("integration", f"{core.integrator}, {_counted(core.substeps, 'step')} per control step"),
        ("first locked frequencies", f"{_numbers(locked)} Hz"),
        ("first free frequencies", f"{_numbers(free)} Hz"),
        ("move time", f"{core.move_time:.2f} s"),
        ("rate scale", f"{core.rate_scale:.3g} rad/s"),
        ("speed scale", f"{arm.reach * core.rate_scale:.3g} m/s"),
    ]
    return table(("", ""), rows)


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
        rows.append((index, f"`{part.name}`", components(env.core, part), _numbers(scale) + unit))
    env.close()
    return f"{layout.size} elements.\n\n" + table(("index", "name", "of", "scale"), rows)


def components(core: Core, part: Part) -> str:
    """The joints, coordinates, directions or strain gauges of the elements of a part."""
    if part.name.startswith("modal"):
        return ", ".join(core.arm.names[k] for k in part.entries)
    if part.name in ("tip_error", "tip_acceleration", *GOALS):
        return ", ".join("xyz"[k] for k in part.entries)
    if part.name == "root_curvature":
        return ", ".join(f"link {k // 2 + 1} {'yz'[k % 2]}" for k in part.entries)
    if part.name in ("base_position", "base_velocity", "target_position"):
        return ", ".join("xy"[k] for k in part.entries)
    if part.name.startswith("base"):
        return "base"
    first, last = part.entries[0] + 1, part.entries[-1] + 1
    return f"joint {first}" if first == last else f"joints {first} to {last}"


def _floating(core: Core) -> str:
    """Further sentences on the start and the target of an arm whose base floats."""
    if not core.arm.base.n:
        return ""
    return (
        " Base: at the described place, at any angle. The target rests in the world: the tip after "
        "this motion of the joints at zero momentum, see [Floating base](README.md#floating-base)."
    )


def _event(core: Core) -> list[str]:
    """Sentences on the event and the cost."""
    found = []
    if core.happening:
        text, (first, last) = EVENTS[core.happening.name].text, core.move_time * np.array(TIME)
        found.append(f"**Event.** {text}. Time: {first:.2f} to {last:.2f} s after the start.")
    if core.curvature_limit is not None:
        limits = _numbers(core.curvature_limit * core.gauge_scale)
        found.append(f'**Cost.** `info["cost"]`, with a limit of {limits} 1/m.')
    return found


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def _accuracy(env_id: str, core: Core) -> str:
    """Certificate and measured steps of an id, and those of its laboratory hardware."""
    measured = entries(core.arm, core.control_dt)
    own = covering(measured, core.conditions)
    assert own is not None, "A registered environment is measured: see flexarm_env/certify."
    laboratory = gym.make(env_id.replace("Goal", ""), hardware="laboratory").unwrapped
    assert isinstance(laboratory, FlexArmEnv)
    drawn = covering(measured, laboratory.core.conditions)
    event = core.happening.name if core.happening else ""
    text = accuracy(own, command(env_id, FROZEN.get(event, {})))
    if drawn is None:
        return f'{text}\n\nWith `hardware="laboratory"`: {laboratory.core.uncertified}'
    c = drawn["certificate"]
    return (
        f'{text}\n\nWith `hardware="laboratory"`, over its range of payloads and stiffnesses: '
        f"{sentence(c, c['reach'])}\n\n{kinds(c['episodes'])}\n\n{steps(drawn['steps'])}"
    )


# ---- text ---------------------------------------------------------------------------------------


def _code_first(rows: Iterable[Sequence[str]]) -> list[Sequence[str]]:
    """Rows with their first entry as code."""
    return [(f"`{first}`", *rest) for first, *rest in rows]


def _numbers(values: Any) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


def file_name(env_id: str) -> str:
    """File name of an id's page, such as one-link-reach-v0.md."""
    scene, rest = env_id.split("/")[1].split("-", 1)
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", scene).lower() + f"-{rest.lower()}.md"


def filmed(env_id: str) -> str:
    """Id whose film is shown: of goals, events and costs that of the arm and the task alone."""
    return without_variant(env_id) if "Goal" in env_id or is_harder(env_id) else env_id


def film_name(env_id: str) -> str:
    """File name of an id's film, such as one-link-reach-v0.gif."""
    return file_name(env_id).removesuffix("md") + "gif"
