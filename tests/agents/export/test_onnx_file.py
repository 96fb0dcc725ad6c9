"""Policies as ONNX models act in onnxruntime as in Python."""

import json

import numpy as np
import pytest

from tests.agents.export.kinds import (
    KINDS,
    RESTART,
    ROUND_OFF,
    laboratory,
    policy_of,
    readings,
    signals,
    torques,
)

onnxruntime = pytest.importorskip("onnxruntime")
onnx_file = pytest.importorskip("agents.export.onnx_file")


@pytest.mark.parametrize("kind", KINDS)
def test_a_policy_of_every_kind_acts_in_onnx_as_in_python(kind: str) -> None:
    """Two environments side by side, the second an episode later."""
    policy, rows = policy_of(kind), readings()
    made = onnx_file.model(policy, signals(policy), "policy")
    session = onnxruntime.InferenceSession(
        made.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    fresh = np.zeros((1, session.get_inputs()[1].shape[1]), np.float32)
    memory, found = fresh, []
    for k, row in enumerate(rows):
        memory = fresh if k == RESTART else memory
        torque, memory = session.run(None, {"input": row[None], "memory": memory})
        found.append(torque[0])
    limit = laboratory().torque_limit[0]
    np.testing.assert_allclose(found, torques(policy), atol=ROUND_OFF * limit, rtol=0.0)


def test_the_model_states_what_goes_in_and_out() -> None:
    policy = policy_of("tanh")
    made = onnx_file.model(policy, signals(policy), "policy")
    stated = {entry.key: entry.value for entry in made.metadata_props}
    assert (stated["arm"], stated["control_step"]) == ("slim", "0.02")
    assert "the tip stays within" in stated["certificate"]
    units = [row["unit"] for row in json.loads(stated["inputs"])]
    assert units == ["rad", "rad/s", "1/m"]
    assert json.loads(stated["outputs"])[0]["unit"] == "N m"
    assert [value.name for value in made.graph.output] == ["torque", "next_memory"]
