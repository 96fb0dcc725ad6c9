"""A policy as one C99 header: weights, memory, scaling and clipping; only math.h is included."""

import re
from collections.abc import Sequence
from hashlib import sha256
from textwrap import wrap
from typing import Any

import numpy as np

from agents.export.signals import COLUMNS, Signals
from agents.policy import GATES, Policy
from dynamics.types import AnyArray

NUMBERS_BESIDE = 8  # numbers in a line
LONGEST = 98  # characters of a line of text
ACTIVATIONS = {
    "tanh": "tanhf(y[i])",
    "relu": "y[i] > 0.0f ? y[i] : 0.0f",
    "elu": "y[i] > 0.0f ? y[i] : expm1f(y[i])",
}
SQUASHINGS = {"clip": "NAME_clip(y[i], 1.0)", "tanh": "tanhf(y[i])"}

GUARD = """\
#ifndef NAME_CONTENT
#define NAME_CONTENT
#ifdef NAME_H
#error "another policy is named so too: export one of them by --out with another name"
#endif
#define NAME_H

#include <math.h>
"""
HELPERS = """\
static inline double NAME_clip(double x, double most)
{
    return x < -most ? -most : x > most ? most : x;
}

/* y = w x + b, of w (rows, columns) */
static inline void NAME_dense(const float *w, const float *b, int rows, int columns,
                              const float *x, float *y)
{
    for (int i = 0; i < rows; i++) {
        float sum = 0.0f;
        for (int j = 0; j < columns; j++)
            sum += w[i * columns + j] * x[j];
        y[i] = sum + b[i];
    }
}
"""
CELLS = """\
static inline float NAME_logistic(float x)
{
    return 0.5f * tanhf(0.5f * x) + 0.5f;
}

/* one step of n LSTM cells: x (columns - n) becomes their output (n), y is scratch */
static inline void NAME_lstm(const float *w, const float *b, int n, int columns, float *x, float *y,
                             float *output, float *content)
{
    for (int i = 0; i < n; i++)
        x[columns - n + i] = output[i];
    NAME_dense(w, b, 4 * n, columns, x, y);
    for (int i = 0; i < n; i++) {
        content[i] = NAME_logistic(y[n + i]) * content[i]
                   + NAME_logistic(y[i]) * tanhf(y[2 * n + i]);
        output[i] = NAME_logistic(y[3 * n + i]) * tanhf(content[i]);
        x[i] = output[i];
    }
}
"""
START = """\
/* Forget what went before: an episode begins. */
static inline void NAME_start(NAME_memory *memory)
{
    static NAME_memory empty; /* all zeros; C++ takes no const without an initializer */
    *memory = empty;
}
"""
ACT = """\
/* Outputs from inputs, once per control step. If an input is not a finite number, the result is 1,
 * all outputs are zero and the memory stays as it is; else the result is 0. */
static inline int NAME_act(NAME_memory *memory, const double input[NAME_INPUTS],
                           double OUTPUT[NAME_OUTPUTS])
{
    float x[NAME_WIDEST], y[NAME_WIDEST];
    for (int i = 0; i < NAME_OUTPUTS; i++)
        OUTPUT[i] = 0.0;
    for (int i = 0; i < NAME_INPUTS; i++)
        if (!isfinite(input[i]))
            return 1;
    for (int i = 0; i < NAME_INPUTS; i++)
        x[i] = (float)NAME_clip(input[i] * NAME_factor[i], NAME_bound[i]);
    for (int i = 0; i < NAME_OUTPUTS; i++)
        x[NAME_INPUTS + i] = memory->action[i];
BODY
    for (int i = 0; i < NAME_OUTPUTS; i++) {
        memory->action[i] = (float)SQUASHED;
        OUTPUT[i] = memory->action[i] * NAME_largest[i];
    }
    return 0;
}
"""
NORMALIZED = """\
    for (int i = 0; i < NAME_OBSERVED; i++)
        x[i] = (float)NAME_clip((x[i] - NAME_mean[i]) / NAME_deviation[i], NAME_MOST);"""
STACKED = """\
    for (int i = 0; i < (NAME_FRAMES - 1) * NAME_OBSERVED; i++)
        memory->frames[i] = memory->frames[i + NAME_OBSERVED];
    for (int i = 0; i < NAME_OBSERVED; i++)
        memory->frames[(NAME_FRAMES - 1) * NAME_OBSERVED + i] = x[i];
    for (int i = 0; i < NAME_FRAMES * NAME_OBSERVED; i++)
        x[i] = memory->frames[i];"""


def header(policy: Policy, signals: Signals, name: str) -> str:
    """Text of NAME.h; `name` is an identifier of C."""
    helpers = [HELPERS] + [CELLS] * (policy.recurrent > 0)
    sections = [
        "\n".join(["/*", *(f" * {line}".rstrip() for line in about(policy, signals)), " */"]),
        GUARD,
        sizes(policy, signals),
        numbers(policy, signals),
        memory(policy),
        *helpers,
        START,
        ACT.replace("BODY", body(policy)).replace("SQUASHED", squashed(policy)),
        "#endif\n",
    ]
    code = "\n".join(sections).replace("OUTPUT[", f"{signals.output}[")
    code = code.replace("NAME_CONTENT", f"NAME_{sha256(code.encode()).hexdigest()[:16].upper()}")
    return re.sub("NAME_(?=[A-Z])", f"{name.upper()}_", code).replace("NAME_", f"{name}_")


def about(policy: Policy, signals: Signals) -> list[str]:
    """Lines of the opening comment: origin, inputs and outputs."""
    origin = policy.about
    texts = [
        f"A policy for {signals.env_id} in C99, made by flexarm export.",
        f"Trained by {origin.get('algorithm')}, {origin.get('steps')} steps, seed "
        f"{origin.get('seed')}, experiment {origin.get('config')}.",
        f"Arm: {signals.arm}. Control step: {signals.control_dt:g} s.",
        f"Simulated arm: {signals.accuracy}",
    ]
    lines = [line for text in texts for line in wrap(plain(text), LONGEST, break_on_hyphens=False)]
    for title, rows in (("Inputs", signals.input_rows()), ("Outputs", signals.output_rows())):
        lines += ["", f"{title}:", *map(plain, aligned([COLUMNS, *rows]))]
    return lines


def plain(text: str) -> str:
    """Text that ends no comment: ASCII on one line, without the end of a comment."""
    kept = "".join(c if c.isascii() and c.isprintable() else "?" for c in text)
    return kept.replace("*/", "* /").replace("/*", "/ *").replace("\\", "?")


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def sizes(policy: Policy, signals: Signals) -> str:
    """Control step, counts, and the first index of every part of the inputs."""
    cells = zip(policy.layer_sizes, policy.layer_sizes[1:], strict=False)
    wide = [max(GATES * n, before + n) for before, n in list(cells)[: policy.recurrent]]
    lines = [
        f"#define NAME_CONTROL_STEP {signals.control_dt!r} /* s */",
        "",
        "enum {",
        f"    NAME_INPUTS = {signals.inputs.size},",
        f"    NAME_OUTPUTS = {signals.largest.size},",
        "    NAME_OBSERVED = NAME_INPUTS + NAME_OUTPUTS,",
        f"    NAME_FRAMES = {policy.stack},",
        f"    NAME_WIDEST = {max([*policy.layer_sizes, policy.n_observation, *wide])},",
    ]
    for part, at in signals.inputs.slices.items():
        lines.append(f"    NAME_{part.upper()} = {at.start},")
    return "\n".join([*lines, "};", ""])


def numbers(policy: Policy, signals: Signals) -> str:
    """Constants: factors and bounds of the inputs, statistics, weights and biases, limits."""
    found = [
        constant("double", "factor", signals.inputs.factors),
        constant("double", "bound", signals.inputs.bounds),
        constant("double", "largest", signals.largest),
    ]
    if policy.normalization is not None:
        statistics = policy.normalization
        deviation = np.sqrt(statistics.variance + statistics.epsilon)
        found.append(f"#define NAME_MOST {statistics.clip!r}\n")
        found += [
            constant("double", "mean", statistics.mean),
            constant("double", "deviation", deviation),
        ]
    for i, (W, b) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        found += [constant("float", f"w{i}", W), constant("float", f"b{i}", b)]
    return "".join(found)


def constant(kind: str, name: str, values: AnyArray) -> str:
    """A constant array, every number with all its digits."""
    suffix, number = ("f", np.float32) if kind == "float" else ("", np.float64)
    texts = [f"{decimal(x)}{suffix}" for x in np.asarray(values, number).ravel()]
    lines = [
        f"    {', '.join(texts[i : i + NUMBERS_BESIDE])},"
        for i in range(0, len(texts), NUMBERS_BESIDE)
    ]
    return "\n".join([f"static const {kind} NAME_{name}[{len(texts)}] = {{", *lines, "};", ""])


def decimal(x: Any) -> str:
    """Shortest decimal that is this number in its precision."""
    return np.format_float_scientific(x, unique=True, trim="0")


def memory(policy: Policy) -> str:
    """Structure of what a policy remembers."""
    fields = ["    float action[NAME_OUTPUTS];"]
    if policy.stack > 1:
        fields.append("    float frames[NAME_FRAMES * NAME_OBSERVED]; /* oldest first */")
    for i, n in enumerate(policy.layer_sizes[1 : policy.recurrent + 1]):
        fields.append(f"    float output{i}[{n}], content{i}[{n}];")
    return "\n".join(["typedef struct {", *fields, "} NAME_memory;", ""])


def body(policy: Policy) -> str:
    """Statements from the scaled observation in x to the last layer in y."""
    found = [NORMALIZED] * (policy.normalization is not None) + [STACKED] * (policy.stack > 1)
    for i, (W, b) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        (rows, columns), n = W.shape, len(b) // GATES
        if i < policy.recurrent:
            places = f"memory->output{i}, memory->content{i}"
            found.append(f"    NAME_lstm(NAME_w{i}, NAME_b{i}, {n}, {columns}, x, y, {places});")
            continue
        found.append(f"    NAME_dense(NAME_w{i}, NAME_b{i}, {rows}, {columns}, x, y);")
        if i < len(policy.weights) - 1:
            found += [f"    for (int i = 0; i < {rows}; i++)",
                      f"        x[i] = {ACTIVATIONS[policy.activation]};"]  # fmt: skip
    return "\n".join(found)


def squashed(policy: Policy) -> str:
    """Action of the last layer's output y[i]."""
    text = SQUASHINGS[policy.squashing]
    if policy.mean_limit is None:
        return text
    return text.replace("y[i]", f"(float)NAME_clip(y[i], {policy.mean_limit!r})")
