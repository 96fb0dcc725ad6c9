"""Tables of the page of the ranking: they are those of the results, and what they say of them."""

import re
from typing import Any

import pytest

from agents.experiments import shipped_experiments
from benchmarks.output import filled
from benchmarks.ranking.standings import (
    COLUMNS,
    PAGE,
    blocks,
    bought,
    cell,
    column,
    gains,
    leaders,
    searched,
    standings,
)

REACH, TRACK = "FlexArm/OneLink-Reach-v0", "FlexArm/OneLink-Track-v0"


def figures(score: float, seeds: int = 0, width: float = 0.01, **others: Any) -> dict[str, Any]:
    """Figures of a classical controller that settles all episodes at a regret of a half."""
    return {
        "score_iqm": score, "score_ci": [score - width, score + width], "training_seeds": seeds,
        "privileged": False, "success_rate": 1.0, "regret_iqm": 0.5, "settling_median": 2.0,
        "tip_error_rms_median": 0.0042, "kind": "classical", "base": None, "improvement": {},
        **others,
    }  # fmt: skip


def test_the_tables_of_the_page_are_those_of_the_results() -> None:
    """If not: python -m benchmarks.ranking.standings"""
    page = PAGE.read_text(encoding="utf-8")
    assert filled(page, blocks()) == page
    changed = re.sub(r"(mpc[a-z-]*: )(\d)", lambda x: x[1] + str((int(x[2]) + 1) % 10), page)
    assert changed != page
    assert filled(changed, blocks()) == page


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("pd-zv-2", "joint control"),
        ("inverse", "joint control"),
        ("lqg-extended-planned", "linear-quadratic"),
        ("mpc-kalman", "predictive"),
        ("nmpc", "predictive"),
    ],
)
def test_classical_columns_follow_the_names(name: str, wanted: str) -> None:
    assert column(name, figures(0.5)) == wanted
    assert column(name, figures(0.5, kind="learned")) == "learned"


@pytest.mark.parametrize(
    ("task", "changes", "text"),
    [
        (REACH, {}, "x: 50 %"),
        (REACH, {"success_rate": 0.98}, "x: 50 %, settles 98 %"),
        (REACH, {"success_rate": 0.996}, "x: 50 %, settles 99.6 %"),
        (REACH, {"success_rate": 0.0}, "x: settles none"),
        (REACH, {"regret_iqm": None}, "x: 2.00 s"),
        (REACH, {"regret_iqm": None, "settling_median": None}, "x: never"),
        (TRACK, {}, "x: 4.2 mm"),
        (TRACK, {"tip_error_rms_median": 0.0421}, "x: 42 mm"),
        (TRACK, {"tip_error_rms_median": None}, "x: fails"),
    ],
)
def test_cells_have_a_number_and_what_is_missed(task: str, changes: Any, text: str) -> None:
    assert cell("x", figures(0.5) | changes, task) == text


def test_rows_have_the_best_of_every_kind_and_mark_the_best_of_all() -> None:
    """`optimal` and idle control are none of them."""
    found = {
        "pd": figures(0.3), "pid": figures(0.4, regret_iqm=0.6), "lqr": figures(0.9),
        "ppo": figures(0.8, 5, kind="learned"), "zero": figures(0.95),
        "optimal": figures(1.0, privileged=True),
    }  # fmt: skip
    *_, row = standings({REACH: {"state": found}}, "state").splitlines()
    cells = [text.strip() for text in row.strip("|").split("|")]
    assert cells == ["OneLink-Reach", "pid: 60 %", "**lqr: 50 %**", "", "ppo: 50 %", ""]
    assert len(cells) == 1 + len(COLUMNS)


def test_a_kind_leads_where_intervals_are_apart_and_gains_where_one_excludes_zero() -> None:
    def rivals(lqr: float, ppo: float, low: float, high: float, width: float = 0.01) -> Any:
        better = {"lqr": {"gain_ci": [low, high]}}
        learned = figures(ppo, 5, width, improvement=better, kind="learned")
        return {"lqr": figures(lqr, width=width), "ppo": learned}

    above, below = rivals(0.8, 0.9, 0.05, 0.15), rivals(0.9, 0.8, -0.15, -0.05)
    close, equal = rivals(0.8, 0.9, 0.05, 0.15, 0.2), rivals(0.9, 0.8, -0.25, 0.05, 0.2)
    stored = {
        REACH: {"state": below, "laboratory": above, "transfer": {"lqr": figures(0.9)}},
        TRACK: {"state": equal, "laboratory": above, "transfer": close},
    }
    one, other, both = "(OneLink-Reach)", "(OneLink-Track)", "(OneLink-Reach, OneLink-Track)"
    none = "  - best learned-on-model over best classical: gain in 0, no gain in 0, loss in 0."
    leads = "kinds that lead: classical in {}, learned-on-model in 0, learned in {}."
    over = "  - best learned over best classical: gain in {}, no gain in {}, loss in {}."
    assert leaders(stored).splitlines() == [
        "- `state`, " + leads.format(f"1 {one}", 0), none, over.format(0, f"1 {other}", f"1 {one}"),
        "- `laboratory`, " + leads.format(0, f"2 {both}"), none, over.format(f"2 {both}", 0, 0),
        "- `transfer`, " + leads.format(0, 0), none, over.format(f"1 {other}", 0, 0),
    ]  # fmt: skip


def test_policies_are_listed_by_their_gain_on_a_ranked_base() -> None:
    def policy(low: float, high: float) -> Any:
        return figures(0.5, 5, base="pd", improvement={"pd": {"gain_ci": [low, high]}})

    found = {"a": policy(0.1, 0.2), "b": policy(-0.1, 0.2), "c": policy(0.1, 0.2) | {"base": "lqr"}}
    assert gains({REACH: {"state": found, "transfer": {"d": policy(-0.2, 0.0)}}}).splitlines() == [
        "- Gain, 1: `a` in OneLink-Reach, state.",
        "- No gain, 2: `b` in OneLink-Reach, state; `d` in OneLink-Reach, transfer.",
        "- Loss, 0: none.",
    ]


def test_experiments_are_searched_where_their_policies_have_an_entry() -> None:
    """Entries of other tracks and of controllers are none of theirs."""
    stored = {
        REACH: {"state": {"ppo": {}, "lqr": {}}, "laboratory": {"lqg": {}}},
        TRACK: {"laboratory": {"ppo": {}}},
    }
    above, below = searched(stored).splitlines()
    assert above == "- Searched, 1: `one_link_reach_ppo`."
    assert f"- By hand, {len(shipped_experiments()) - 1}: " in below
    assert "`one_link_track_ppo`" in below
    assert searched({}).startswith("- Searched, 0: none.")


def test_twenty_minutes_buy_the_best_policy_that_is_trained_in_time_without_a_model() -> None:
    """`one_link_reach_shac` would be better, and takes longer; `ppo-ahead-of-pd` needs a model."""

    def learned(score: float, kind: str = "learned") -> Any:
        return figures(0.5, 3, score_mean=score, kind=kind)

    found = {
        "lqr": figures(0.9, score_mean=0.7), "mpc": figures(0.8, score_mean=0.75),
        "ppo": learned(0.6), "sac": learned(0.61), "shac": learned(0.8),
        "ppo-ahead-of-pd": learned(0.9, "learned-on-model"),
    }  # fmt: skip
    minutes = dict.fromkeys(shipped_experiments(), 10.0)
    minutes |= {"one_link_reach_sac": 20.0, "one_link_reach_shac": 20.1}
    (header, _, row) = bought({REACH: {"state": found, "transfer": found}}, minutes).splitlines()
    assert [text.strip() for text in row.strip("|").split("|")] == [
        "OneLink-Reach", "state", "[one_link_reach_sac](results/one_link_reach_sac.md)", "20.0",
        "0.610", "mpc 0.750",
    ]  # fmt: skip
    assert len(header.split("|")) == len(row.split("|"))
