"""Conditions that measured errors cover, and the sentence of a certificate."""

import json
from dataclasses import replace

import pytest

from flexarm_env.accuracy.certificates import STORE, covering
from flexarm_env.accuracy.conditions import Conditions
from flexarm_env.accuracy.table import accuracy, sentence


def conditions(**ranges: tuple[float, float]) -> Conditions:
    return Conditions(torque_limit=(1.0,), deflection_limit=0.1, ranges=ranges)


def test_errors_of_other_plants_alone_do_not_cover_the_described_one() -> None:
    stiff = conditions(stiffness=(2.0, 3.0))
    assert conditions().beyond(stiff) == "the described stiffness"
    assert conditions(stiffness=(2.0, 2.5)).beyond(stiff) is None
    heavy = conditions(payload_mass=(0.2, 0.4), stiffness=(0.9, 1.1))
    assert conditions(stiffness=(1.0, 1.0)).beyond(heavy) == "the described payload_mass"
    assert conditions().beyond(conditions(payload_mass=(0.0, 0.4), stiffness=(0.9, 1.1))) is None


def test_errors_of_many_plants_do_not_hold_for_a_part_of_them() -> None:
    """An entry of the same plants comes first; without one the steps are those of the many."""
    many = conditions(payload_mass=(0.0, 0.4), stiffness=(0.9, 1.1))
    heavy = conditions(payload_mass=(0.4, 0.4), stiffness=(0.9, 1.1))
    assert heavy.beyond(many) is None
    assert heavy.part(many) == "payload_mass drawn from 0.4 to 0.4 at resets"
    assert conditions().part(many) == "payload_mass drawn from 0 to 0 at resets"
    assert many.part(many) is None
    entries = [{"certificate": {"holds": x.to_dict()}} for x in (many, heavy)]
    assert covering(entries, heavy) == entries[1]
    assert covering(entries[:1], heavy) == entries[0]


def test_errors_with_a_payload_for_good_do_not_cover_one_that_is_dropped() -> None:
    carried = conditions(payload_mass=(0.0, 0.4))
    dropped = replace(carried, drop=True)
    assert dropped.beyond(carried) == "a payload that is dropped in mid-episode"
    assert dropped.beyond(Conditions.from_dict(dropped.to_dict())) is None
    assert carried.beyond(dropped) is None


@pytest.mark.parametrize(
    ("until", "words"),
    [
        (None, "In 95 of 100 whole episodes of every kind the tip stays within 2 mm"),
        (0.7, "stays within 1 mm (0.001 of the reach) up to 0.7 s of the reference"),
    ],
)
def test_a_certificate_without_a_reach_is_told_in_words(until: float | None, words: str) -> None:
    """Certificates of a search hold none."""
    kinds = {"random": {"until": [until], "share": 0.002}}
    found = {"episodes": {"kinds": kinds, "levels": [0.001], "share": 0.95}}
    assert words in sentence(found, 1.0)


def test_steps_that_err_by_a_hundredth_of_the_reach_are_not_said_to_keep_the_error() -> None:
    scenes = json.loads(STORE.read_text(encoding="utf-8")).values()
    for found in (x for scene in scenes for x in scene["measured"]):
        kept = "Steps that keep the error" in accuracy(found, "a command")
        assert kept == (max(step["error"] for step in found["steps"]) < 1e-2)
