"""Counts on straight-line code: by hand on small code, and by running what threads share."""

import operator

import numpy as np
import pytest

from benchmarks.speed import splits

SMALL = {0: [], 1: [], 2: [], 3: [0, 1], 4: [2, 3], 5: [0, 4]}
OPERATIONS = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
    "neg": operator.neg,
}  # fmt: skip


def test_values_are_alive_until_their_last_use(monkeypatch: pytest.MonkeyPatch) -> None:
    assert splits.alive(SMALL) == 3  # 0, 1 and 2
    assert splits.alive(splits.sparing({0: [], 1: [], 2: [0], 3: [1], 4: [2, 3]})) == 2
    monkeypatch.setattr(splits, "GAP", 1)
    gaps, again = splits.computed_again(SMALL)
    assert sorted(gaps[0]) == [(0, 3), (3, 5)]
    assert again == 4  # 0 twice, 1 and 2
    assert splits.alive(SMALL, gaps) == 1


def test_independent_chains_need_no_barrier() -> None:
    chains = {k: [k - 2] if k > 1 else [] for k in range(20)}
    assert splits.longest_path(chains) == 10
    assert splits.shared_out(chains, 2, 50) == {"share": 0.5, "barriers": 0, "exchanged": 0}


def test_threads_that_exchange_values_at_barriers_compute_the_accelerations() -> None:
    """A value of another thread is known only after a barrier."""
    function = splits.traced("FlexArm/OneLink-Reach-v0")[0]
    code, needs = function.code, splits.needs_of(function)
    random = iter(np.random.default_rng(0).uniform(0.5, 1.5, len(code.statements)))
    given = {
        v: float(op[6:]) if op.startswith("const") else float(next(random))
        for v, (op, _) in enumerate(code.statements)
        if v not in needs
    }

    def run(v: int, known: dict[int, float]) -> float:
        op, operands = code.statements[v]
        return float(OPERATIONS[op](*(known[a] for a in operands)))

    expected = dict(given)
    for v in needs:
        expected[v] = run(v, expected)
    shared = dict(given)
    for work in splits.phases(needs, 3, 20):
        found = [dict(shared) for _ in work]
        for statements, known in zip(work, found, strict=True):
            for v in statements:
                known[v] = run(v, known)
        for known in found:
            shared |= known
    assert shared == expected
