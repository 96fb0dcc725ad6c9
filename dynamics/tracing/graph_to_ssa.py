"""SSA code from a CasADi expression graph."""

from collections.abc import Sequence
from typing import Any

from dynamics.tracing.elementary_functions import cos, sin, sqrt, tanh
from dynamics.tracing.ssa import Code


def from_graph(graph: Any, slots: Sequence[int], expand: bool = True) -> tuple[Code, list[int]]:
    """SSA code of a CasADi SX Function with one output vector.

    `slots[i]` is the first slot of input i. `expand` replaces sin, cos and tanh by basic
    operations. Returns the code and the numbers of the output's elements.
    """
    import casadi as ca

    simple = {
        ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_NEG: "neg",
        ca.OP_FABS: "abs", ca.OP_FMIN: "min", ca.OP_FMAX: "max", ca.OP_LT: "less",
        ca.OP_LE: "at_most", ca.OP_FLOOR: "rounded",
    }  # fmt: skip
    functions = {ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TANH: "tanh"}
    code = Code()
    expanded = {"sin": sin, "cos": cos, "tanh": tanh}
    registers: dict[int, int] = {}
    outputs = [code.constant(0.0)] * graph.nnz_out(0)
    for k in range(graph.n_instructions()):
        op = graph.instruction_id(k)
        args, out = graph.instruction_input(k), graph.instruction_output(k)
        if op == ca.OP_OUTPUT:
            outputs[out[1]] = registers[args[0]]
            continue
        if op == ca.OP_INPUT:
            value = code.load(slots[args[0]] + args[1])
        elif op == ca.OP_CONST:
            value = code.constant(graph.instruction_constant(k))
        else:
            x = [registers[a] for a in args]
            if op == ca.OP_SQRT:
                value = sqrt(code, x[0])
            elif op in simple:
                value = code.emit(simple[op], *x)
            elif op == ca.OP_SQ:
                value = code.emit("*", x[0], x[0])
            elif op == ca.OP_TWICE:
                value = code.emit("+", x[0], x[0])
            elif op in (ca.OP_DIV, ca.OP_INV):  # quotients by one pivot share its reciprocal
                value = code.emit("/", code.constant(1.0), x[-1])
                value = code.emit("*", x[0], value) if op == ca.OP_DIV else value
            elif op in functions:
                name = functions[op]
                value = expanded[name](code, x[0]) if expand else code.emit(name, x[0])
            else:
                raise ValueError(
                    f"No code for CasADi operation {op}; add it to tracing/graph_to_ssa.py."
                )
        registers[out[0]] = value
    return code, outputs
