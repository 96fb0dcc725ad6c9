"""Controllers in the same episodes on the default model and on the reference."""

import pytest

from benchmarks.ranking.on_reference import met


def test_control_of_exact_states_scores_alike_on_both_models() -> None:
    """The certificate of one link is a thousandth of the reach, a twentieth of the settled band."""
    found = met("FlexArm/OneLink-Reach-v0", "lqr", [0, 1])
    assert min(found["default"]["score"]) > 0.7
    assert found["reference"]["score"] == pytest.approx(found["default"]["score"], abs=0.02)
    assert found["reference"]["score"] != found["default"]["score"]
