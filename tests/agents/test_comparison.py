"""Titles of evaluations."""

import pytest

from agents.comparison import titled


@pytest.mark.parametrize(
    ("kwargs", "words"),
    [
        ({}, ""),
        ({"hardware": "laboratory", "obs": "sensors"}, " hardware=laboratory obs=sensors"),
        (
            {"hardware": {"preset": "laboratory", "payload": [0.5, 0.75], "gauge_noise": 0.1}},
            " hardware=laboratory (payload 0.5 to 0.75, gauge_noise 0.1)",
        ),
        ({"randomize": {"stiffness": (0.8, 1.2)}}, " randomize=(stiffness 0.8 to 1.2)"),
        ({"hardware": {"preset": "laboratory"}}, " hardware=laboratory"),
    ],
)
def test_titles_say_keywords_in_words(kwargs: dict[str, object], words: str) -> None:
    assert titled("FlexArm/OneLink-Reach-v0", kwargs) == "FlexArm/OneLink-Reach-v0" + words
