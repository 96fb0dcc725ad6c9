"""A policy as an ONNX model of standard operators."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agents.export.signals import COLUMNS, Signals
from agents.policy import Policy
from dynamics.extras import missing
from dynamics.types import AnyArray

try:
    import onnx
    from onnx import TensorProto, helper, numpy_helper
except ModuleNotFoundError as error:
    raise missing(error, "flexarm export --format onnx", "export") from None

OPSET, IR = 17, 9  # what runtimes have read since 2023
ACTIVATIONS = {"tanh": "Tanh", "relu": "Relu", "elu": "Elu"}


class Graph:
    """Nodes and constants of a graph; methods return the name of what they add."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, values: Any, kind: type = np.float32) -> str:
        """A constant array."""
        name = f"constant{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(values, kind), name))
        return name

    def add(self, operator: str, *inputs: str, outputs: int = 1, **attributes: Any) -> Any:
        """A node; returns the name of its output, or the names of several."""
        names = [f"{operator.lower()}{len(self.nodes)}_{i}" for i in range(outputs)]
        self.nodes.append(helper.make_node(operator, list(inputs), names, **attributes))
        return names[0] if outputs == 1 else names

    def split(self, x: str, sizes: Sequence[int]) -> list[str]:
        """Consecutive columns of these sizes."""
        names = self.add("Split", x, self.constant(sizes, np.int64), outputs=len(sizes), axis=1)
        return [names] if len(sizes) == 1 else list(names)

    def clip(self, x: str, most: AnyArray | float, kind: type = np.float32) -> str:
        """Numbers within [-most, most]."""
        low, high = (self.constant(sign * np.asarray(most), kind) for sign in (-1.0, 1.0))
        return str(self.add("Min", self.add("Max", x, low), high))

    def dense(self, W: AnyArray, b: AnyArray, x: str) -> str:
        """W x + b."""
        return str(self.add("Gemm", x, self.constant(W), self.constant(b), transB=1))

    def cast(self, x: str, kind: int) -> str:
        """The numbers in another type."""
        return str(self.add("Cast", x, to=kind))


def model(policy: Policy, signals: Signals, name: str) -> Any:
    """The model: inputs and memory to outputs and the next memory, of N environments."""
    graph, m = Graph(), signals.largest.size
    n_memory = policy.n_state + m
    *kept, action = graph.split("memory", [policy.n_state, m] if policy.n_state else [m])
    scaled = graph.add("Mul", "input", graph.constant(signals.inputs.factors, np.float64))
    scaled = graph.clip(scaled, signals.inputs.bounds, np.float64)
    x = graph.add("Concat", graph.cast(scaled, TensorProto.FLOAT), action, axis=1)
    x, after = remembered(graph, policy, normalized(graph, policy, x), kept)
    first = policy.recurrent
    for W, b in zip(policy.weights[first:-1], policy.biases[first:-1], strict=True):
        x = graph.add(ACTIVATIONS[policy.activation], graph.dense(W, b, x))
    x = graph.dense(policy.weights[-1], policy.biases[-1], x)
    if policy.mean_limit is not None:
        x = graph.clip(x, policy.mean_limit)
    action = graph.add("Tanh", x) if policy.squashing == "tanh" else graph.clip(x, 1.0)
    largest = graph.constant(signals.largest, np.float64)
    outputs = {
        signals.output: ("Mul", graph.cast(action, TensorProto.DOUBLE), largest),
        "next_memory": ("Concat", *after, action),
    }
    for output, (operator, *inputs) in outputs.items():
        axis = {"axis": 1} if operator == "Concat" else {}
        graph.nodes.append(helper.make_node(operator, inputs, [output], **axis))
    kinds = {
        "input": (TensorProto.DOUBLE, signals.inputs.size),
        "memory": (TensorProto.FLOAT, n_memory),
        signals.output: (TensorProto.DOUBLE, m),
        "next_memory": (TensorProto.FLOAT, n_memory),
    }
    values = [helper.make_tensor_value_info(k, kind, ["N", n]) for k, (kind, n) in kinds.items()]
    made = helper.make_model(
        helper.make_graph(graph.nodes, name, values[:2], values[2:], graph.constants),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR,
        producer_name="flexarm",
    )
    helper.set_model_props(made, about(policy, signals))
    onnx.checker.check_model(made, full_check=True)
    return made


def normalized(graph: Graph, policy: Policy, x: str) -> str:
    """Observation as the statistics of the training normalize it, if there are any."""
    found = policy.normalization
    if found is None:
        return x
    deviation = np.sqrt(found.variance + found.epsilon)
    shifted = graph.add(
        "Sub", graph.cast(x, TensorProto.DOUBLE), graph.constant(found.mean, np.float64)
    )
    scaled = graph.add("Div", shifted, graph.constant(deviation, np.float64))
    return graph.cast(graph.clip(scaled, found.clip, np.float64), TensorProto.FLOAT)


def remembered(graph: Graph, policy: Policy, x: str, kept: Sequence[str]) -> tuple[str, list[str]]:
    """Input of the perceptron, and what is kept of it: stacked observations, LSTM cells."""
    if not kept:
        return x, []
    stacked = [policy.observation_low.size] * (policy.stack > 1)
    cells = policy.layer_sizes[1 : policy.recurrent + 1]
    before = graph.split(kept[0], [*stacked, *np.repeat(cells, 2)])
    after: list[str] = []
    if stacked:
        older = stacked[0] - policy.n_observation
        _, later = graph.split(before.pop(0), [policy.n_observation, older])
        x = graph.add("Concat", later, x, axis=1)
        after.append(x)
    for W, b in zip(policy.weights[: policy.recurrent], policy.biases, strict=False):
        x, content = lstm(graph, W, b, x, before.pop(0), before.pop(0))
        after += [x, content]
    return x, after


def lstm(graph: Graph, W: AnyArray, b: AnyArray, x: str, h: str, c: str) -> tuple[str, str]:
    """One step of LSTM cells, as `agents.policy.lstm`."""
    gates = graph.dense(W, b, graph.add("Concat", x, h, axis=1))
    i, f, g, o = graph.split(gates, [b.size // 4] * 4)
    held = graph.add("Mul", graph.add("Sigmoid", f), c)
    content = graph.add(
        "Add", held, graph.add("Mul", graph.add("Sigmoid", i), graph.add("Tanh", g))
    )
    return graph.add("Mul", graph.add("Sigmoid", o), graph.add("Tanh", content)), content


def about(policy: Policy, signals: Signals) -> Mapping[str, str]:
    """Metadata: environment, arm, control step, certificate, and what goes in and out."""
    tables = {"inputs": signals.input_rows(), "outputs": signals.output_rows()}
    rows = {
        key: [dict(zip(COLUMNS, row, strict=True)) for row in table]
        for key, table in tables.items()
    }
    data = {
        "environment": signals.env_id,
        "arm": signals.arm,
        "control_step": signals.control_dt,
        "certificate": signals.accuracy,
        "training": {
            key: policy.about.get(key) for key in ("algorithm", "steps", "seed", "config")
        },
    } | rows
    return {key: x if isinstance(x, str) else json.dumps(x) for key, x in data.items()}
