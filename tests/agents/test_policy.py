"""A stored policy is arrays and JSON, and acts exactly as the network it came from.

Its files may be anybody's: whatever is wrong is one sentence, and costs neither time nor memory.
"""

import io
import json
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import pytest
from numpy.lib import format as npy
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack
from torch.nn import LSTM

from agents.learners.export import export_policy, load_zip, lstm_cells
from agents.policy import Policy, PolicyError, load_policy, save_policy
from tests.agents.run_folder.damages import Damage, cut, flipped, stuffed
from tests.agents.toys import Toy, build

BOMB = 2**28  # bytes


@pytest.fixture(scope="module", params=["ppo", "sac"])
def model(request: pytest.FixtureRequest) -> Any:
    model = build(request.param)
    model.learn(64)
    with_large_actions = model.policy.action_net if request.param == "ppo" else model.actor.mu
    with_large_actions.weight.data *= 30.0  # so that clipping and squashing have work to do
    return model


def test_stored_policy_acts_as_the_network(model: Any, tmp_path: Path) -> None:
    save_policy(export_policy(model, {"env_id": "toy"}), tmp_path)
    policy = load_policy(tmp_path)
    observations = np.random.default_rng(0).uniform(-5.0, 5.0, (200, 3)).astype(np.float32)

    expected, _ = model.predict(observations, deterministic=True)
    actions, _ = policy.predict(observations)

    np.testing.assert_allclose(actions, expected, atol=2e-6)  # float32 sums in another order
    assert (np.abs(actions) > 0.99).any()
    single, _ = policy.predict(observations[0])
    np.testing.assert_allclose(single, actions[0], atol=2e-6)
    assert policy.about["env_id"] == "toy"


def test_policy_files_hold_no_pickle(model: Any, tmp_path: Path) -> None:
    """Every array loads with pickling forbidden, and the rest is JSON."""
    save_policy(export_policy(model, {}), tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {"policy.json", "weights.npz"}
    json.loads((tmp_path / "policy.json").read_text())
    with np.load(tmp_path / "weights.npz", allow_pickle=False) as arrays:
        assert all(arrays[name].dtype == np.float32 for name in arrays.files)


def test_a_zip_is_unpickled_only_on_trust(model: Any, tmp_path: Path) -> None:
    model.save(tmp_path / "model.zip")
    with pytest.raises(PolicyError, match="--trust"):
        load_zip(tmp_path / "model.zip")

    policy = load_zip(tmp_path / "model.zip", trust=True)

    observation = np.array([0.3, -0.2, 0.9], np.float32)
    expected = model.predict(observation, deterministic=True)[0]
    np.testing.assert_allclose(policy.predict(observation)[0], expected, atol=2e-6)


def test_a_zip_of_another_algorithm_is_refused_before_it_is_unpickled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    DQN("MlpPolicy", "CartPole-v1").save(tmp_path / "model.zip")
    monkeypatch.setattr("stable_baselines3.common.save_util.cloudpickle.loads", pytest.fail)
    with pytest.raises(PolicyError, match="'ddpg', 'ppo', 'recurrent-ppo', 'sac', 'td3'"):
        load_zip(tmp_path / "model.zip", trust=True)


@pytest.mark.parametrize("error", [KeyError("x"), SyntaxError("x"), AssertionError("x\ny")])
def test_any_error_of_unpickling_becomes_a_policy_error(
    model: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*arguments: Any, **keywords: Any) -> None:
        raise error

    model.save(tmp_path / "model.zip")
    monkeypatch.setattr("stable_baselines3.common.base_class.load_from_zip_file", fail)
    with pytest.raises(PolicyError, match="cannot be loaded as a file of stable-") as caught:
        load_zip(tmp_path / "model.zip", trust=True)
    assert "\n" not in str(caught.value)


def test_an_object_array_is_refused(model: Any, tmp_path: Path) -> None:
    """numpy stores object arrays as pickles, which are not loaded."""
    policy = export_policy(model, {})
    save_policy(policy, tmp_path)
    arrays = {f"W{i}": W for i, W in enumerate(policy.weights)}
    arrays["b0"] = np.array([{"a": 1}], dtype=object)
    np.savez(tmp_path / "weights.npz", **arrays)
    with pytest.raises(PolicyError, match="must hold plain numbers, got object"):
        load_policy(tmp_path)


def test_policies_refuse_unsupported_calls(model: Any) -> None:
    policy = export_policy(model, {})
    with pytest.raises(ValueError, match="takes 3 observations"):
        policy.predict(np.zeros(4))
    with pytest.raises(ValueError, match="mean action only"):
        policy.predict(np.zeros(3), deterministic=False)


# ---- files of strangers ----------------------------------------------------------------------


def small_policy() -> Policy:
    rng = np.random.default_rng(0)
    layers = [(3, 16), (16, 2)]
    return Policy(
        weights=tuple(rng.normal(size=(o, i)).astype(np.float32) for i, o in layers),
        biases=tuple(rng.normal(size=o).astype(np.float32) for _, o in layers),
        activation="tanh",
        squashing="clip",
        observation_low=np.full(3, -5.0, np.float32),
        observation_high=np.full(3, 5.0, np.float32),
        about={"env_id": "FlexArm/OneLink-Reach-v0"},
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An intact stored policy."""
    save_policy(small_policy(), tmp_path)
    return tmp_path


def refusal(folder: Path) -> str:
    """Message of the policy's refusal, without the folder."""
    with pytest.raises(PolicyError) as caught:
        load_policy(folder)
    sentence = str(caught.value)
    assert sentence.startswith(str(folder))
    assert "\n" not in sentence
    return sentence.removeprefix(str(folder))


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        ({"format": "other"}, "format must be 'flexarm-policy-1', got 'other'; another version"),
        ({"format": "flexarm-policy-2", "heads": 2}, "got 'flexarm-policy-2'; another version"),
        ({"layer_sizes": []}, "layer_sizes must have 2 to 10 entries, got 0"),
        ({"layer_sizes": [3]}, "layer_sizes must have 2 to 10 entries, got 1"),
        ({"layer_sizes": [3] * 11}, "layer_sizes must have 2 to 10 entries, got 11"),
        ({"layer_sizes": "three"}, "layer_sizes must be a list"),
        ({"layer_sizes": {"3": 2}}, "layer_sizes must be a list"),
        ({"layer_sizes": None}, "layer_sizes must be a list"),
        ({"layer_sizes": [3, 10**12, 2]}, "must be between 1 and 2048, got 10000"),
        ({"layer_sizes": [3, -16, 2]}, "must be between 1 and 2048, got -16"),
        ({"layer_sizes": [3, True, 2]}, "must be an int, got True"),
        ({"layer_sizes": [3, 16.0, 2]}, "must be an int, got 16.0"),
        ({"recurrent": 2}, "recurrent must be between 0 and 1, got 2"),
        ({"recurrent": 1}, "do not have the stated layer sizes [3, 16, 2]"),
        ({"layer_sizes": [3, 17, 2]}, "do not have the stated layer sizes [3, 17, 2]"),
        ({"activation": "system"}, "activation must be one of"),
        ({"activation": ["tanh"]}, "activation must be one of"),
        ({"squashing": None}, "squashing must be one of"),
        ({"mean_limit": 0.0}, "mean_limit must be positive, got 0.0"),
        ({"mean_limit": None}, "mean_limit [-] must be a number, got None"),
        ({"observation_low": [0.0]}, "observation_low must have 3 numbers, got 1"),
        ({"observation_low": "low"}, "observation_low must be a list"),
        ({"observation_high": [1.0, 2.0, float("inf")]}, "must be a finite number"),
        ({"observation_high": [-9.0, 5.0, 5.0]}, "must not be above observation_high"),
        ({"action_low": [-1.0, "low"]}, "must be a number"),
        ({"action_high": [1.0, 0.5]}, "actions must be in [-1, 1], got [(-1.0, -1.0), (1.0, 0.5)]"),
        ({"about": []}, "about must be a table, got []"),
        ({"about": None}, "about must be a table, got None"),
        ({"about": {"env_id": ["a"]}}, "about.env_id must be text"),
        ({"code": "import os"}, "Unknown key 'code' in policy.json"),
    ],
)
def test_wrong_fields_are_refused(folder: Path, damage: dict[str, Any], sentence: str) -> None:
    path = folder / "policy.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | damage))
    assert sentence in refusal(folder)


def test_a_folder_that_cannot_be_looked_into_is_refused(tmp_path: Path) -> None:
    """As one without permission is, which root may enter all the same."""
    assert refusal(tmp_path / ("x" * 300))


@pytest.mark.parametrize("name", ["format", "layer_sizes", "action_high", "about"])
def test_a_missing_field_is_named(folder: Path, name: str) -> None:
    path = folder / "policy.json"
    description = json.loads(path.read_text())
    del description[name]
    path.write_text(json.dumps(description))
    assert f"policy.json lacks {name}" in refusal(folder)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "is not valid JSON"),
        (b"null", "must hold a mapping"),
        (b"[]", "must hold a mapping"),
        (b'{"format": ', "is not valid JSON"),
        (b"\xff\xfe\x00", "must be UTF-8 text"),
        (b"[" * 100_000, "nested too deep"),
        (b'{"a":' * 100_000, "nested too deep"),
        (b'{"format": "' + b"x" * 2**20 + b'"}', "policy.json must be at most 1_048_576 bytes"),
        (b'{"layer_sizes": 1' + b"0" * 5000 + b"}", "policy.json lacks about"),
    ],
)
def test_other_json_is_refused(folder: Path, content: bytes, sentence: str) -> None:
    (folder / "policy.json").write_bytes(content)
    assert sentence in refusal(folder)


def stored(array: Any) -> bytes:
    file = io.BytesIO()
    npy.write_array(file, np.asarray(array))
    return file.getvalue()


def archive(folder: Path, **changed: bytes | None) -> None:
    """Rewrite the weights with some members changed, or omitted if None."""
    policy = small_policy()
    members: dict[str, bytes | None] = {f"W{i}": stored(W) for i, W in enumerate(policy.weights)}
    members |= {f"b{i}": stored(b) for i, b in enumerate(policy.biases)}
    with ZipFile(folder / "weights.npz", "w") as file:
        for name, data in (members | changed).items():
            if data is not None:
                file.writestr(f"{name}.npy", data)


def claiming(shape: tuple[int, ...], descr: str = "<f4") -> bytes:
    """An array header of the given shape, followed by a few bytes only."""
    file = io.BytesIO()
    npy.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": shape})
    return file.getvalue() + bytes(64)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"b0": claiming((10**10,))}, "claims 40000000000 bytes of numbers, but has 64"),
        ({"b0": claiming((-16,))}, "claims -64 bytes"),
        ({"b0": stored(np.zeros(16, "M8[s]"))}, "must hold plain numbers, got datetime64"),
        ({"b0": stored(np.zeros(16, "S4"))}, "must hold plain numbers"),
        ({"b0": stored(np.zeros(16, "f4,f4"))}, "must hold plain numbers"),
        ({"b0": stored(np.zeros(16, complex))}, "must hold plain numbers"),
        ({"b0": stored(np.zeros(16, np.float16))}, "must be float32 or float64, got float16"),
        ({"b0": stored(np.zeros(16, int))}, "must be float32 or float64, got float32, int64"),
        ({"b0": stored(np.zeros(16, ">f4"))}, "must be float32 or float64"),
        ({"b0": stored(np.zeros(15, np.float32))}, "do not have the stated layer sizes"),
        ({"b0": stored(np.zeros((16, 1), np.float32))}, "do not have the stated layer sizes"),
        ({"b0": stored(np.full(16, np.nan, np.float32))}, "not finite"),
        ({"b0": None}, "do not have the stated layer sizes"),
        ({"extra": stored(np.zeros(1))}, "do not have the stated layer sizes"),
        ({"b0": b""}, "does not start with the header"),
        ({"b0": b"\x93NUMPY\x02\x00" + b"\xff" * 200}, "does not start with the header"),
        ({"b0": b"\x93NUMPY\x01\x00\x00\x10" + b"(" * 4096}, "does not start with the header"),
        ({"b0": b"\x93NUMPY\x01\x00\x00\x0f" + b"-" * 3840 + b"1"}, "does not start with"),
        ({"extra": bytes(2**17)}, "must be at most 66_320 bytes for layer sizes [3, 16, 2]"),
    ],
)
def test_wrong_arrays_are_refused(
    folder: Path, changed: dict[str, bytes | None], sentence: str
) -> None:
    archive(folder, **changed)
    assert sentence in refusal(folder)


def test_two_arrays_with_the_same_name_are_refused(folder: Path) -> None:
    with ZipFile(folder / "weights.npz", "a") as file, pytest.warns(UserWarning, match="Duplicate"):
        file.writestr("b0.npy", stored(np.ones(16, np.float32)))
    assert "two arrays have the same name" in refusal(folder)


@pytest.mark.parametrize("content", [b"", b"PK\x05\x06", b"no archive", b"\x93NUMPY" + bytes(99)])
def test_other_archives_are_refused(folder: Path, content: bytes) -> None:
    (folder / "weights.npz").write_bytes(content)
    assert "is not a complete archive of arrays" in refusal(folder)


def test_an_archive_bomb_is_refused_before_decompression(folder: Path) -> None:
    """A quarter of a gibibyte of zeros in 0.3 MB costs neither time nor memory."""
    with (
        ZipFile(folder / "weights.npz", "w", ZIP_DEFLATED, compresslevel=9) as file,
        file.open("W0.npy", "w", force_zip64=True) as member,
    ):
        npy.write_array_header_1_0(
            member, {"descr": "<f4", "fortran_order": False, "shape": (BOMB // 4,)}
        )
        for _ in range(BOMB // 2**24):
            member.write(bytes(2**24))
    assert (folder / "weights.npz").stat().st_size < 2**21
    description = json.loads((folder / "policy.json").read_text())
    description["layer_sizes"] = [3, 2048, 2048, 2]  # so that a file of this size is allowed
    (folder / "policy.json").write_text(json.dumps(description))

    tracemalloc.start()
    begin = time.process_time()
    sentence = refusal(folder)
    seconds, (_, peak) = time.process_time() - begin, tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert "'W0.npy' is compressed" in sentence
    assert seconds < 0.5
    assert peak < 2**25  # a limit of 16 MiB on JSON is a buffer of as much


def test_weights_that_overflow_raise_a_policy_error(folder: Path) -> None:
    """Finite weights with infinite products."""
    archive(
        folder,
        W0=stored(np.full((16, 3), 3e38, np.float32)),
        W1=stored(np.array([[3e38, -3e38] * 8] * 2, np.float32)),
        b0=stored(np.zeros(16, np.float32)),
    )
    (folder / "policy.json").write_text(
        (folder / "policy.json").read_text().replace("tanh", "relu")
    )
    policy = load_policy(folder)
    with pytest.raises(PolicyError, match="so large that its action is not a number"):
        policy.predict(np.ones(3))


@pytest.mark.filterwarnings("error")
def test_lstm_cells_saturate_where_their_gates_overflow() -> None:
    """Silently: with open gates, content grows by one a step."""
    policy = replace(
        small_policy(),
        weights=(np.full((64, 19), 3e38, np.float32), np.eye(2, 16, dtype=np.float32)),
        biases=(np.zeros(64, np.float32), np.zeros(2, np.float32)),
        recurrent=1,
    )
    action, state = policy.predict(np.full(3, 2.0))
    np.testing.assert_allclose(action, np.tanh(1.0))
    assert policy.predict(np.full(3, 2.0), state)[1][-1] == 2.0


@pytest.mark.parametrize("option", [{"bidirectional": True}, {"proj_size": 1}, {"bias": False}])
def test_lstm_cells_that_cannot_be_stored_are_refused(option: dict[str, Any]) -> None:
    with pytest.raises(PolicyError, match="Only LSTM layers with biases, in one direction"):
        lstm_cells(LSTM(3, 2, **option))


@pytest.mark.parametrize("damage", [cut, flipped, stuffed])
@pytest.mark.parametrize("name", ["policy.json", "weights.npz"])
def test_a_randomly_damaged_policy_loads_or_is_refused(
    folder: Path, name: str, damage: Damage
) -> None:
    """300 random damages give a policy or a PolicyError."""
    path, rng = folder / name, np.random.default_rng(0)
    whole = path.read_bytes()
    refused = 0
    for _ in range(300):
        path.write_bytes(damage(whole, rng))
        try:
            assert load_policy(folder).weights[0].shape == (16, 3)
        except PolicyError:
            refused += 1
    assert refused > 150


def test_a_policy_with_a_memory_acts_as_its_network_on_stacked_observations(
    tmp_path: Path,
) -> None:
    """Across ends of episodes, against stable-baselines3's own stacking."""
    envs = VecFrameStack(DummyVecEnv([Toy, Toy]), 3)
    envs.seed(0)
    model = PPO("MlpPolicy", envs, n_steps=32, batch_size=32, seed=0)
    save_policy(export_policy(model, {"stack": 3}), tmp_path)
    policy = load_policy(tmp_path)
    assert (policy.stack, policy.n_observation) == (3, 3)
    stacked: Any = envs.reset()
    starts, state, ends = np.ones(2, bool), None, 0
    for _ in range(60):
        expected, _ = model.predict(stacked, deterministic=True)
        actions, state = policy.predict(stacked[:, -3:], state, starts)
        np.testing.assert_allclose(actions, expected, atol=2e-6)
        stacked, _, starts, _ = envs.step(expected)
        ends += int(starts.sum())
    assert ends > 2
    single, memory = policy.predict(stacked[0, -3:])
    assert single.shape == (2,)
    assert policy.predict(stacked[0, -3:], memory)[1].shape == (9,)


def test_a_stack_that_does_not_fit_is_refused(model: Any, tmp_path: Path) -> None:
    save_policy(export_policy(model, {"stack": 2}), tmp_path)
    with pytest.raises(PolicyError, match="must divide the 3 observations"):
        load_policy(tmp_path)
