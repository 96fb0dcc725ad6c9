"""Counts on six links: other orders of their statements, and several threads per environment.

    python -m benchmarks.speed.splits [--out docs/results/splits.json]

Counts on the statements of `accelerations`, without a compiler: values alive at once, and work,
exchanged values and barriers where threads share an evaluation. Fills the table of docs/gpu.md.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym

from benchmarks.output import (
    ROOT,
    argument_parser,
    fill,
    paragraphs,
    provenance,
    save_results,
    table,
)
from dynamics import Arm
from dynamics.tracing.assembly import Program
from dynamics.tracing.function import Function
from flexarm_env import FlexArmVectorEnv
from flexarm_env.interfaces.tensors.device import kernel_source

PAGE = ROOT / "docs" / "gpu.md"
SCENE = "FlexArm/SixLink-Reach-v0"
CHEAP, GAP = 3, 500  # operations computed again, and statements between two uses that are worth it
THREADS = (2, 4)
FOREIGN = 300  # statements by which one that needs another thread's value waits
PHASES = (50, 150, 400)  # statements of a thread between barriers
Needs = Mapping[int, Sequence[int]]  # value -> operands, in the order of computation


def traced(env: str) -> tuple[Function, Program, Arm]:
    """The traced equations of motion of an environment, the program they are of, and its arm."""
    envs = gym.make_vec(env, num_envs=1)
    assert isinstance(envs, FlexArmVectorEnv)
    program = kernel_source(envs.core).program
    function = next(x for x in program.functions if x.name == "accelerations")
    return function, program, envs.core.model.arm


def needs_of(function: Function) -> dict[int, list[int]]:
    """Operands of each computed value; constants and loaded slots need no register."""
    code = function.code
    free = {v for v, (op, _) in enumerate(code.statements) if op.split()[0] in ("load", "const")}
    return {
        v: [a for a in dict.fromkeys(args) if a not in free]
        for v, (_, args) in enumerate(code.statements)
        if v not in free
    }


def users_of(needs: Needs) -> dict[int, list[int]]:
    """Values that each value is an operand of."""
    users: dict[int, list[int]] = defaultdict(list)
    for v, operands in needs.items():
        for a in operands:
            users[a].append(v)
    return users


def alive(needs: Needs, gaps: Mapping[int, Sequence[tuple[int, int]]] | None = None) -> int:
    """Largest number of values alive after a statement; none is within its gaps between uses."""
    place = {v: k for k, v in enumerate(needs)}
    changes = [0] * (len(needs) + 1)
    for v, users in users_of(needs).items():
        ends = [place[v], max(place[u] for u in users)]
        ends[1:1] = [place[x] for gap in sorted((gaps or {}).get(v, ())) for x in gap]
        for k, end in enumerate(ends):
            changes[end] += (-1) ** k
    count = most = 0
    for change in changes:
        count += change
        most = max(most, count)
    return most


def sparing(needs: Needs) -> dict[int, list[int]]:
    """Statements in another order, each time one that leaves fewest values alive."""
    users = users_of(needs)
    open_operands = {v: len(operands) for v, operands in needs.items()}
    uses = {v: len(users[v]) for v in needs}
    ready = {v for v, count in open_operands.items() if not count}
    order: dict[int, list[int]] = {}
    while ready:
        v = min(ready, key=lambda v: ((uses[v] > 0) - sum(uses[a] == 1 for a in needs[v]), v))
        ready.remove(v)
        order[v] = list(needs[v])
        for a in needs[v]:
            uses[a] -= 1
        for u in users[v]:
            open_operands[u] -= 1
            if not open_operands[u]:
                ready.add(u)
    return order


def computed_again(needs: Needs) -> tuple[dict[int, list[tuple[int, int]]], int]:
    """Gaps in which cheap values are not alive, longest first, and operations done again."""
    users = users_of(needs)
    last = {v: max(of) for v, of in users.items()}
    gaps: dict[int, list[tuple[int, int]]] = defaultdict(list)
    read: dict[int, list[int]] = defaultdict(list)  # places where a value must be alive

    def operations(v: int, at: int, anchors: list[int]) -> int:
        """Operations that give v again at a place, of anchors alive there."""
        count = 1
        for a in needs[v]:
            if at <= last[a] and not any(x < at < y for x, y in gaps[a]):
                anchors.append(a)
            elif count <= CHEAP:
                count += operations(a, at, anchors)
        return count

    pairs = [(x, y, v) for v in users for x, y in zip([v, *users[v]], users[v], strict=False)]
    total = 0
    for x, y, v in sorted(pairs, key=lambda pair: pair[0] - pair[1]):
        anchors: list[int] = []
        if y - x <= GAP or any(x < at < y for at in read[v]):
            continue
        if (count := operations(v, y, anchors)) <= CHEAP:
            gaps[v].append((x, y))
            total += count
            for a in anchors:
                read[a].append(y)
    return gaps, total


def phases(needs: Needs, threads: int, length: int) -> list[list[list[int]]]:
    """Statements by phase and thread, at most `length` of a thread between two barriers.

    The thread with least work takes the earliest statement whose operands it has, preferring those
    that need its own values. Values of other threads are those of earlier phases.
    """
    users = users_of(needs)
    open_operands = {v: len(operands) for v, operands in needs.items()}
    ready = {v for v, count in open_operands.items() if not count}
    home: dict[int, tuple[int, int]] = {}  # value -> phase, thread
    result: list[list[list[int]]] = []
    while ready:
        now, work = len(result), [[] for _ in range(threads)]  # type: tuple[int, list[list[int]]]
        while taken := _next(needs, ready, home, work, now, length):
            thread, v = taken
            home[v] = now, thread
            work[thread].append(v)
            ready.remove(v)
            for u in users[v]:
                open_operands[u] -= 1
                if not open_operands[u]:
                    ready.add(u)
        result.append(work)
    return result


def _next(
    needs: Needs,
    ready: set[int],
    home: Mapping[int, tuple[int, int]],
    work: Sequence[Sequence[int]],
    now: int,
    length: int,
) -> tuple[int, int] | None:
    """Thread and the statement that it takes next, if any can go on in this phase."""
    for thread in sorted(range(len(work)), key=lambda k: len(work[k])):
        has = {v: [home[a] for a in needs[v]] for v in ready}
        able = [v for v in ready if all(k == thread or at < now for at, k in has[v])]
        if able and len(work[thread]) < length:
            return thread, min(
                able, key=lambda v: v + FOREIGN * sum(k != thread for _, k in has[v])
            )
    return None


def shared_out(needs: Needs, threads: int, length: int) -> dict[str, float]:
    """Share of the longest thread, barriers, and values that pass from thread to thread."""
    found = phases(needs, threads, length)
    owner = {v: k for work in found for k, of in enumerate(work) for v in of}
    crossing = {a for v, operands in needs.items() for a in operands if owner[a] != owner[v]}
    return {
        "share": sum(max(map(len, work)) for work in found) / len(needs),
        "barriers": len(found) - 1,
        "exchanged": len(crossing),
    }


def fused(function: Function) -> int:
    """Sums that take along a product which nothing else needs: one multiply-add each."""
    needs, statements = needs_of(function), function.code.statements
    users = users_of(needs)
    alone = {v for v in needs if statements[v][0] == "*" and len(users[v]) == 1}
    return sum(statements[v][0] in "+-" and bool(alone & set(needs[v])) for v in needs)


def planes(function: Function, program: Program, arm: Arm) -> dict[str, int]:
    """Statements that depend on the modes of no plane of bending, of one alone, or of both."""
    each = [plane for link in arm.links for plane in ("", *(m.direction for m in link.modes))]
    slots = {program.at[x] + k: plane for x in ("Q", "V") for k, plane in enumerate(each)}
    found: dict[int, set[str]] = {}
    for v, (op, operands) in enumerate(function.code.statements):
        own = slots.get(int(op.split()[1]), "") if op.startswith("load") else ""
        found[v] = {own} - {""} | {plane for a in operands for plane in found[a]}
    return dict(Counter("".join(sorted(found[v])) or "none" for v in needs_of(function)))


def longest_path(needs: Needs) -> int:
    """Statements of which each needs the one before."""
    depth: dict[int, int] = {}
    for v, operands in needs.items():
        depth[v] = 1 + max((depth[a] for a in operands), default=0)
    return max(depth.values())


def measure(env: str = SCENE) -> dict[str, Any]:
    """All counts of an environment's accelerations."""
    function, program, arm = traced(env)
    needs = needs_of(function)
    gaps, again = computed_again(needs)
    return {
        "statements": len(needs),
        "fused": fused(function),
        "path": longest_path(needs),
        "alive": {
            "as traced": alive(needs),
            "in another order": alive(sparing(needs)),
            "computed again": alive(needs, gaps),
        },
        "again": again,
        "planes": planes(function, program, arm),
        "threads": [
            {"threads": t, "length": n, **shared_out(needs, t, n)} for t in THREADS for n in PHASES
        ],
    }


def page(results: dict[str, Any]) -> str:
    """Values alive at once, shares of threads, and planes."""
    found, of = results["alive"], results["planes"]
    return "\n\n".join([
        table(
            [f"{results['statements']:,} statements, longest path {results['path']}", "alive"],
            [
                ["as traced", str(found["as traced"])],
                ["each time one that leaves fewest alive", str(found["in another order"])],
                [f"{results['again']} operations done again", str(found["computed again"])],
            ],
            "lr",
        ),
        table(
            ["threads", "statements between barriers", "statements of the longest thread",
             "barriers", "values exchanged"],
            [
                [str(x["threads"]), f"at most {x['length']}", f"{100.0 * x['share']:.0f} %",
                 str(x["barriers"]), f"{x['exchanged']:,}"]
                for x in results["threads"]
            ],
            "rlr",
        ),
        f"{results['fused']:,} sums can take a product along in a multiply-add. "
        f"{of['y']} statements depend on the modes of the plane y alone, {of['z']} on those of z, "
        f"{of['yz']:,} on both.",
    ])  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Count, write the results and fill the page."""
    parser = argument_parser("speed.splits", __doc__, "splits.json")
    options = parser.parse_args(arguments)
    results = provenance("casadi") | measure()
    text = page(results)
    save_results(results, paragraphs("# Splits of the six links' equations", text), options.out)
    if options.out == parser.get_default("out"):
        fill(PAGE, {"splits": text})


if __name__ == "__main__":
    main()
