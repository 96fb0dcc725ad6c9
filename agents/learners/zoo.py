"""Settings of RL Zoo, pasted into `agent.kwargs` of an experiment, moved to their places here.

Zoo writes tables as Python calls, such as "dict(net_arch=[64, 64])". They are parsed and never
evaluated: only `dict` with keywords, literals and activations of torch are understood.
"""

import ast
from collections.abc import Mapping
from typing import Any

from dynamics.description import validate

PLACES = {  # key of Zoo: section and key here
    "n_timesteps": ("", "total_steps"),
    "n_envs": ("env", "n_envs"),
    "env_kwargs": ("env", "kwargs"),
    "frame_stack": ("env", "stack"),
    "normalize": ("env", "normalize"),
    "policy": ("agent", "policy"),
}
HINTS = {key: f"{section}.{here}".lstrip(".") for key, (section, here) in PLACES.items()} | {
    "policy_kwargs": "agent.kwargs.policy_kwargs",
    "env_wrapper": "env.reward (a table of reward terms and weights)",
}
ACTIVATIONS = {"Tanh": "tanh", "ReLU": "relu", "ELU": "elu"}  # classes of torch.nn, names here
MODULES = ("nn", "th.nn", "torch.nn")
TABLES = {  # key whose table may be a text: an example of one
    "policy_kwargs": "dict(net_arch=[64, 64], activation_fn=nn.ReLU)",
    "env_kwargs": "dict(hardware='laboratory')",
    "normalize": "dict(norm_obs=True, norm_reward=False)",
}
LONGEST = 2000  # characters of a table in Python's form
DEVICES = ("cpu", "auto")
REFUSED = {  # key of Zoo: remedy
    "env_wrapper": "set env.reward, a table of reward terms and weights, or env.kwargs",
    "vec_env_wrapper": "set env.stack for stacked observations",
    "callback": "leave it out: a run logs and writes checkpoints itself",
    "monitor_kwargs": "leave it out: a run logs every episode itself",
}


def translated(data: Any) -> Any:
    """An experiment whose `agent.kwargs` may hold settings of RL Zoo, with those in their places.

    Raises
    ------
    ValueError : for a setting that is given twice, or that a run cannot honour.
    """
    agent = data.get("agent") if isinstance(data, Mapping) else None
    kwargs = agent.get("kwargs") if isinstance(agent, Mapping) else None
    if not isinstance(agent, Mapping) or not isinstance(kwargs, Mapping):
        return data
    kwargs = {key: plain(key, value) for key, value in kwargs.items()}
    for key, remedy in REFUSED.items():
        if key in kwargs:
            raise ValueError(f"agent.kwargs.{key} of RL Zoo names code to import; {remedy}.")
    kwargs.pop("device", None)
    result = {**data, "agent": {**agent, "kwargs": kwargs}}
    for key, (section, here) in PLACES.items():
        if key in kwargs:
            put(result, section, here, kwargs.pop(key), f"agent.kwargs.{key}")
    return result


def put(data: dict[str, Any], section: str, key: str, value: Any, where: str) -> None:
    """Set a key of a section, unless the experiment has it already."""
    table = data.get(section, {}) if section else data
    if not isinstance(table, Mapping):
        return  # the section's own check refuses it
    if key in table:
        here = f"{section}.{key}" if section else key
        raise ValueError(f"{where} and {here} are one setting; keep one of them.")
    if section:
        data[section] = {**table, key: value}
    else:
        data[key] = value


def plain(key: Any, value: Any) -> Any:
    """A setting as experiments write it; refuses those that a run cannot honour."""
    where = f"agent.kwargs.{key}"
    if key == "n_timesteps" and isinstance(value, float) and value.is_integer():
        return int(value)  # Zoo writes !!float 1e6
    if key in TABLES and isinstance(value, str):
        return table_of(value, where, TABLES[key])
    if key == "train_freq" and isinstance(value, list):
        if len(value) != 2 or value[1] != "step":
            raise ValueError(
                f"{where} must count steps, as 8 or [8, step], got {validate.shown(value)}: the "
                "environments of a batch end their episodes at different steps."
            )
        return value[0]
    if key == "device" and value not in DEVICES:
        raise ValueError(
            f"{where} must be one of {list(DEVICES)}, got {validate.shown(value)}: networks of "
            "this size train on the processor."
        )
    return value


def table_of(text: str, where: str, example: str) -> dict[str, Any]:
    """Table of a text such as the example, without eval."""
    try:
        if len(text) > LONGEST:
            raise ValueError("it is too long")
        tree = ast.parse(text.strip(), mode="eval").body
        if not isinstance(tree, ast.Call | ast.Dict):
            raise ValueError("it is no table")
        table: dict[str, Any] = value_of(tree)
    except (SyntaxError, ValueError, RecursionError, MemoryError, TypeError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else str(error) or "nested too deeply"
        raise ValueError(
            f"{where} must be a table, or a text such as {example!r} of plain values, got "
            f"{validate.shown(text)} ({reason})."
        ) from None
    return table


def value_of(node: ast.expr) -> Any:
    """Plain value of a parsed expression; a ValueError for anything but literals and `dict`."""
    if isinstance(node, ast.List | ast.Tuple):
        return [value_of(element) for element in node.elts]
    if isinstance(node, ast.Dict):
        return {name_of(k): value_of(v) for k, v in zip(node.keys, node.values, strict=True)}
    if isinstance(node, ast.Call):
        names = [keyword.arg for keyword in node.keywords]
        if ast.unparse(node.func) != "dict" or node.args or None in names:
            raise ValueError("only dict(name=value, ...) may be called")
        return {keyword.arg: value_of(keyword.value) for keyword in node.keywords}
    if isinstance(node, ast.Attribute):
        if ast.unparse(node.value) in MODULES and node.attr in ACTIVATIONS:
            return ACTIVATIONS[node.attr]
        raise ValueError(f"{ast.unparse(node)!r} is none of {[f'nn.{x}' for x in ACTIVATIONS]}")
    return ast.literal_eval(node)


def name_of(node: ast.expr | None) -> str:
    """Key of a literal table, which must be text."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    raise ValueError("keys must be texts")
