"""Operation counts of expression graphs."""

from collections import Counter
from itertools import accumulate
from typing import Any

from dynamics.tracing.graph_to_ssa import from_graph


def operations(graph: Any, offline: int = 0) -> dict[str, int]:
    """Number of operations of each kind in a graph; negations are not counted.

    Operations that depend only on the first `offline` inputs are precomputed and not counted.
    A doubling x + x counts as a multiplication.
    """
    kinds = {
        "multiplications": ("*",), "additions": ("+", "-"), "divisions": ("/",),
        "sines and cosines": ("sin", "cos"),
    }  # fmt: skip
    starts = [0, *accumulate(graph.nnz_in(k) for k in range(graph.n_in()))]
    code, _ = from_graph(graph, starts, expand=False)
    online: list[bool] = []
    counts: Counter[str] = Counter()
    for op, args in code.statements:
        if op.startswith("load"):
            online.append(int(op[5:]) >= starts[offline])
        else:
            online.append(offline == 0 or any(online[x] for x in args))
        if online[-1]:
            counts["*" if op == "+" and args[0] == args[1] else op] += 1
    return {kind: sum(counts[op] for op in group) for kind, group in kinds.items()}
