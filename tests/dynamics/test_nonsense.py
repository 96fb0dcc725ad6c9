"""Invalid arguments and files: each is refused with a sentence, or gives finite results."""

import copy
import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynamics import (
    ARMS,
    Arm,
    Base,
    Body,
    Diverged,
    Joint,
    JointMotion,
    Link,
    Mode,
    Payload,
    Scene,
    Section,
    Stepper,
    choose_model,
    compile_arm,
    limits,
    load_arm,
    simulate,
)
from dynamics.accuracy.scene import bang_bang, cycloid, release
from dynamics.description.arm import MOST_LINKS
from dynamics.description.data_file import MOST_BYTES, MOST_NODES
from dynamics.model import Model
from dynamics.tracing import graphs
from tests.refusal import NONSENSE, used_or_refused

MODEL = compile_arm("slim")
REST = np.zeros(3)
STEPPER = Stepper(MODEL, 2, dt=1e-3, substeps=1)
MEASURED = np.zeros((2, MODEL.n_measure))
SCENE = Scene(motions=(bang_bang((0.1,), 0.1, 0.3),))
TUBE = (Section(length=1.0, rho_A=1.0, EIz=5.0),)
SOLID = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def described(cls: Any, **base: Any) -> dict[str, Callable[[Any], Any]]:
    """One call per field of a description, with the value to try."""
    return {
        f"{cls.__name__}.{field.name}": lambda x, name=field.name: cls(**{**base, name: x})
        for field in fields(cls)
    }


def motion(torque: Any, integrator: str = "auto", **more: Any) -> Any:
    return simulate(MODEL, REST, REST, torque, [0.0, 0.01], integrator=integrator, **more)


def jumping(breakpoints: Any) -> Callable[[float], Any]:
    """A torque that lists `breakpoints`."""

    def torque(t: float) -> Any:
        return [0.0]

    torque.breakpoints = breakpoints  # type: ignore[attr-defined]
    return torque


CALLS: dict[str, Callable[[Any], Any]] = {
    "load_arm": load_arm,
    "load_arm units": lambda x: load_arm({**PLAIN[0], "units": x}),
    "load_arm sections": lambda x: load_arm({"links": [{"sections": x, "modes": "auto"}]}),
    "compile_arm": compile_arm,
    "compile_arm formulation": lambda x: compile_arm("slim", formulation=x),
    "compile_arm dtype": lambda x: compile_arm("slim", dtype=x),
    "compile_arm free_parameters": lambda x: compile_arm("slim", free_parameters=x),
    "compile_arm free parameter": lambda x: compile_arm("slim", free_parameters=[x]),
    "Stepper model": lambda x: Stepper(x, 2, dt=1e-3, substeps=1),
    "Stepper n_env": lambda x: Stepper(MODEL, x, dt=1e-3, substeps=1),
    "Stepper dt": lambda x: Stepper(MODEL, 2, dt=x, substeps=1),
    "Stepper substeps": lambda x: Stepper(MODEL, 2, dt=1e-3, substeps=x),
    "Stepper integrator": lambda x: Stepper(MODEL, 2, dt=1e-3, substeps=1, integrator=x),
    "Stepper threads": lambda x: Stepper(MODEL, 2, dt=1e-3, substeps=1, threads=x),
    "Stepper.measure q": lambda x: STEPPER.measure(x, STEPPER.v, MEASURED),
    "Stepper.measure v": lambda x: STEPPER.measure(STEPPER.q, x, MEASURED),
    "Stepper.measure out": lambda x: STEPPER.measure(STEPPER.q, STEPPER.v, x),
    "strain q": lambda x: MODEL.strain(x, 0, 0.1),
    "strain link": lambda x: MODEL.strain(REST, x, 0.1),
    "strain x": lambda x: MODEL.strain(REST, 0, x),
    "mass_matrix": MODEL.mass_matrix,
    "bias": lambda x: MODEL.bias(REST, x),
    "accelerations": lambda x: MODEL.accelerations(REST, REST, x),
    "inverse_dynamics": lambda x: MODEL.inverse_dynamics(REST, REST, x),
    "inverse_dynamics wrench": lambda x: MODEL.inverse_dynamics(REST, REST, REST, wrench=x),
    "energy": lambda x: MODEL.energy(x, REST),
    "momentum": lambda x: MODEL.momentum(REST, x),
    "tip": MODEL.tip,
    "tip_velocity": lambda x: MODEL.tip_velocity(REST, x),
    "frequencies": MODEL.frequencies,
    "frequencies joints": lambda x: MODEL.frequencies(REST, joints=x),
    "linearize": lambda x: MODEL.linearize(REST, REST, x),
    "christoffel": lambda x: MODEL.christoffel(x, REST),
    "simulate model": lambda x: simulate(x, REST, REST, None, [0.0, 0.1]),
    "simulate q": lambda x: simulate(MODEL, x, REST, None, [0.0, 0.1]),
    "simulate torque": motion,
    "simulate torque function": lambda x: motion(lambda t: x),
    "simulate torque function, fixed steps": lambda x: motion(lambda t: x, "rk4"),
    "simulate torque breakpoints": lambda x: motion(jumping(x)),
    "simulate times": lambda x: simulate(MODEL, REST, REST, None, x),
    "simulate integrator": lambda x: motion(None, x),
    "simulate dt": lambda x: motion(None, "rk4", dt=x),
    "simulate rtol": lambda x: motion(None, rtol=x),
    "limits model": lambda x: limits(x, motion(None)),
    "limits trajectory": lambda x: limits(MODEL, x),
    "choose_model arm": lambda x: choose_model(x, SCENE, 0.1),
    "choose_model scene": lambda x: choose_model("slim", x, 0.1),
    "choose_model tolerance": lambda x: choose_model("slim", SCENE, x),
    "bang_bang torques": lambda x: bang_bang(x, 0.1, 1.0),
    "bang_bang pulse": lambda x: bang_bang((0.1,), x, 1.0),
    "cycloid": lambda x: cycloid((0.1,), x, 1.0),
    "release": lambda x: release(x, 1.0),
    "JointMotion torque breakpoints": lambda x: (
        JointMotion(joint_angles=(0.0,), joint_rates=(0.0,), t_end=1.0, torque=jumping(x)).knots
    ),
    **described(Scene, motions=SCENE.motions),
    **described(JointMotion, joint_angles=(0.0,), joint_rates=(0.0,), t_end=1.0),
    **described(Link, length=1.0, rho_A=1.0),
    **{f"{name} beside sections": call for name, call in described(Link, sections=TUBE).items()},
    **described(Joint),
    **described(Mode, kind="poly", index=1, direction="y"),
    **described(Payload, mass=1.0),
    **described(Body, mass=1.0),
    **described(Base, type="free", mass=1.0, inertia=SOLID),
    **described(Arm, links=(Link(length=1.0, rho_A=1.0),)),
}


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
def test_nonsense_is_refused_with_a_sentence(call: Callable[[Any], Any]) -> None:
    for value in NONSENSE:
        with used_or_refused(Diverged, RuntimeError):
            call(value)


def test_a_torque_of_another_length_is_refused() -> None:
    for integrator in ("rk4", "dop853", "radau"):
        with pytest.raises(ValueError, match=r"torque\(0.* s\) must have shape \(1,\), got \(2,\)"):
            motion(lambda t: [0.1, 0.2], integrator)


@pytest.mark.parametrize(
    ("name", "value"),
    [("dt", 0.0), ("dt", -1e-3), ("dt", math.nan), ("substeps", 0), ("substeps", 2.5)],
)
def test_a_bad_step_is_refused_where_it_is_set_too(name: str, value: Any) -> None:
    """Compiled code would take 2 of 2.5 substeps."""
    with pytest.raises(ValueError, match=rf"^{name} .*got {value}\b"):
        setattr(STEPPER, name, value)
    assert (STEPPER.dt, STEPPER.substeps) == (1e-3, 1)


@pytest.mark.parametrize("quantity", ["strain", "linearize", "christoffel", "mass_matrix"])
def test_a_state_beyond_double_precision_is_refused_by_name(quantity: str) -> None:
    far = np.full(3, 1e300)
    calls: dict[str, Callable[[], Any]] = {
        "strain": lambda: MODEL.strain(1e8 * far, 0, 0.0),
        "linearize": lambda: MODEL.linearize(far, far, [0.0]),
        "christoffel": lambda: MODEL.christoffel(far, far),
        "mass_matrix": lambda: MODEL.mass_matrix(far),
    }
    with pytest.raises(ValueError, match=f"^{quantity} at this state must be finite"):
        calls[quantity]()


def test_a_motion_that_neither_trial_can_begin_has_diverged() -> None:
    """The automatic choice of a method tries Radau's, whose matrix is not finite either."""
    with pytest.raises(Diverged, match="diverged at t = 0 s"):
        motion([1e300])
    still = simulate(MODEL, REST, REST, None, [0.0, 1e-320])
    assert not still.q.any()


@pytest.mark.parametrize("rtol", [10.0, 1.0, 0.0, -1.0, 1e-15])
def test_a_relative_tolerance_that_controls_no_error_is_refused(rtol: float) -> None:
    with pytest.raises(ValueError, match=f"rtol must be at least 3e-14 and below 1, got {rtol!r}"):
        motion(None, rtol=rtol)


def test_the_arrays_of_a_stepper_cannot_be_replaced() -> None:
    """Compiled code would read beyond the end of a smaller array."""
    for name in ("q", "v", "torque", "parameters", "status", "measured"):
        with pytest.raises(AttributeError):
            setattr(STEPPER, name, np.zeros(1))


@pytest.mark.parametrize("name", ["model", "n_env", "integrator", "threads"])
def test_what_a_stepper_is_compiled_for_cannot_be_changed_without_effect(name: str) -> None:
    with pytest.raises(AttributeError):
        setattr(STEPPER, name, getattr(STEPPER, name))


# ---- descriptions --------------------------------------------------------------------------------

PLAIN = [arm.to_dict() for arm in ARMS.values() if arm.n <= 12]
LINK_NUMBERS = ("length", "rho_A", "EIz", "EIy", "GJ", "EA", "rho_Ip", "tip_mass", "damping_beta")
JOINT_NUMBERS = (
    "rotor_inertia", "hub_inertia", "viscous", "coulomb", "coulomb_speed", "stiffness",
    "spring_damping",
)  # fmt: skip
numbers = st.one_of(
    st.sampled_from([0.0, -1.0, 1e30, 1e31, math.nan, math.inf]),
    st.floats(-30.0, 30.0).map(lambda x: 10.0**x),
    st.floats(-3.0, 3.0).map(lambda x: 10.0**x),
)
changes = st.tuples(
    st.integers(0, 5),
    st.one_of(
        st.tuples(st.just("link"), st.sampled_from(LINK_NUMBERS)),
        st.tuples(st.just("joint"), st.sampled_from(JOINT_NUMBERS)),
        st.tuples(st.just("arm"), st.sampled_from(["gravity", "payload", "offset"])),
    ),
    numbers,
)


def changed(plain: dict[str, Any], changes: list[Any]) -> dict[str, Any]:
    """A description with some numbers replaced."""
    result = copy.deepcopy(plain)
    for place, (owner, name), value in changes:
        link = result["links"][place % len(result["links"])]
        joint = link.setdefault("joint", {})
        if owner == "arm":
            parts = {"gravity": [0, -value, 0], "payload": {"mass": value}, "offset": [value, 0, 0]}
            (joint if name == "offset" else result)[name] = parts[name]
        else:
            (link if owner == "link" else joint)[name] = value
        if name == "damping_beta":
            link.pop("damping_ratio", None)
    return result


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(plain=st.sampled_from(PLAIN), numbers=st.lists(changes, min_size=1, max_size=6))
def test_a_description_is_refused_or_gives_finite_results(
    plain: dict[str, Any], numbers: list[Any]
) -> None:
    """Several replaced numbers at once: 1e-30 to 1e31, zero, negative and non-finite ones."""
    with used_or_refused():
        model = Model(load_arm(changed(plain, numbers)))
        q = model.rigid(np.full(model.n, 0.3))
        graphs.check_rest(model.traced)
        results = [
            model.mass_matrix(q), model.bias(q, q), model.energy(q, q), model.frequencies(),
            model.tip(q),
        ]  # fmt: skip
        assert all(np.isfinite(result).all() for result in results)


@pytest.mark.parametrize(
    "numbers",
    [
        {(0, "rho_A"): 1e-20, (0, "tip_mass"): 1e-10},
        {(0, "rotor_inertia"): 1e-5, (1, "tip_mass"): 1e30},
        {(0, "tip_mass"): 1.0, (1, "tip_mass"): 1e25},
    ],
)
def test_an_arm_with_a_singular_mass_matrix_is_refused(numbers: dict[Any, float]) -> None:
    """Singular to round-off, so that its accelerations would not be finite."""
    plain = copy.deepcopy(ARMS["korayem-two-link"].to_dict())
    plain["links"][0]["EIz"] = 1e-10
    for (place, name), value in numbers.items():
        link = plain["links"][place]
        (link.setdefault("joint", {}) if name == "rotor_inertia" else link)[name] = value
    with pytest.raises(ValueError, match="too far apart"):
        Stepper(compile_arm(plain), 1, dt=1e-3, substeps=1)


json_values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)


@settings(max_examples=200, deadline=None)
@given(plain=st.sampled_from(PLAIN), data=st.data())
def test_any_value_anywhere_in_a_description_is_used_or_refused(
    plain: dict[str, Any], data: st.DataObject
) -> None:
    result: Any = copy.deepcopy(plain)
    place = result
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = data.draw(st.sampled_from(keys))
        if not isinstance(place[key], dict | list) or not place[key] or data.draw(st.booleans()):
            break
        place = place[key]
    place[key] = data.draw(json_values)
    with used_or_refused():
        Model(load_arm(result))


# ---- files ---------------------------------------------------------------------------------------


def refused(path: Path, content: str | bytes) -> str:
    """The message that refuses a file within ten seconds."""
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    begin = time.monotonic()
    with pytest.raises(ValueError, match=path.name) as caught:
        load_arm(path)
    assert time.monotonic() - begin < 10.0
    return str(caught.value)


LINK = {"length": 1.0, "rho_A": 1.0}


def test_a_file_beyond_a_limit_is_refused_with_the_limit(tmp_path: Path) -> None:
    for suffix, most in MOST_BYTES.items():
        sentence = refused(tmp_path / f"arm{suffix}", " " * (most + 1))
        assert f"at most {most} bytes" in sentence
    links = json.dumps({"links": (MOST_LINKS + 1) * [LINK]})
    assert "links must have at most 1000 entries, got 1001" in refused(tmp_path / "a.json", links)
    modes = 201 * [{"kind": "poly", "index": 1, "direction": "y"}]
    many = json.dumps({"links": [LINK | {"EIz": 1.0, "modes": modes}]})
    assert "modes must have at most 200 entries, got 201" in refused(tmp_path / "a.json", many)
    cut = [LINK | {"EIz": 1.0, "segments": 501, "modes": [*modes[:1], modes[0] | {"index": 2}]}]
    sentence = refused(tmp_path / "a.json", json.dumps({"links": cut}))
    assert "at most 1000 coordinates" in sentence
    assert "got 1003" in sentence


def test_yaml_aliases_count_with_all_their_values(tmp_path: Path) -> None:
    """Nine lists, each with nine aliases of the one before, stand for 9^9 links."""
    lines = ["a0: &a0 {length: 1.0, rho_A: 1.0}"]
    lines += [f"a{k}: &a{k} [{', '.join(9 * [f'*a{k - 1}'])}]" for k in range(1, 10)]
    bomb = "\n".join([*lines, "links: *a9"])
    assert f"at most {MOST_NODES} values" in refused(tmp_path / "arm.yaml", bomb)
    merged = [f"a{k}: &a{k} {{<<: [{', '.join(9 * [f'*a{k - 1}'])}]}}" for k in range(1, 10)]
    assert "values" in refused(tmp_path / "arm.yaml", "\n".join([lines[0], *merged]))
    assert "alias inside" in refused(tmp_path / "arm.yaml", "links: &a [*a]")
    flat = "links: [" + ", ".join(MOST_NODES * ["1"]) + "]"
    assert "values" in refused(tmp_path / "arm.yaml", flat)
    repeated = "x: &link {length: 1.0, rho_A: 1.0}\nlinks: [*link, *link]".replace("x:", "name:")
    assert "Arm.name must be text" in refused(tmp_path / "arm.yaml", repeated)
    (tmp_path / "arm.yaml").write_text("links: [&link {length: 1.0, rho_A: 1.0}, *link]")
    assert load_arm(tmp_path / "arm.yaml").n_joint == 2


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("deep.json", 100_000 * "["),
        ("deep.yaml", 100_000 * "["),
        ("digits.json", '{"gravity": [' + 5000 * "1" + "]}"),
        ("digits.yaml", "gravity: [" + 5000 * "1" + "]"),
        ("date.yaml", "name: 2001-99-99"),
        ("tag.yaml", "name: !!python/object/apply:os.system ['touch canary']"),
        ("keys.yaml", "{[1]: 2}"),
        ("twice.json", '{"name": "a", "name": "b"}'),
        ("bytes.json", b"\xff\xfe"),
        ("list.json", "[]"),
        ("empty.yaml", ""),
        ("plain.txt", "{}"),
    ],
)
def test_an_invalid_file_is_refused_at_once(
    name: str, content: str | bytes, tmp_path: Path
) -> None:
    refused(tmp_path / name, content)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.json")
    with pytest.raises(ValueError, match="not a regular file"):
        load_arm(tmp_path / "pipe.json")


@pytest.mark.parametrize("name", ["a\0b.json", 5000 * "a" + ".json", "\ud800.yaml"])
def test_an_impossible_path_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"cannot read|no such file"):
        load_arm(name)
