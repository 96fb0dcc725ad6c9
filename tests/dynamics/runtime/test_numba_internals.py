"""Private parts of numba stand in one place, and a newer numba does without them."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from dynamics.runtime.numba_internals import NEWEST, _sources, _usable
from tests.imports import imported, sources
from tests.paths import ROOT

ALLOWED = {"dynamics/runtime/numba_internals.py"}

SESSION = """
import json, sys, warnings
import numba
numba.__version__ = sys.argv[1]
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    import gymnasium as gym
    import numpy as np
    import flexarm_env
    from dynamics import Stepper, compile_arm
    model = compile_arm("slim")
    stepper = Stepper(model, 20, dt=1e-4, substeps=2, integrator="midpoint", threads=2)
    stepper.torque[:] = np.linspace(-1.0, 1.0, 20)[:, None]
    stepper.advance()
    envs = gym.make_vec("FlexArm/OneLink-Track-v0", num_envs=20)
    obs, _ = envs.reset(seed=1)
    steps = [envs.step(np.full(envs.action_space.shape, 0.3, np.float32)) for _ in range(3)]
obs, rewards, ended, _, _ = steps[-1]
print(json.dumps({
    "warned": [str(w.message) for w in caught if "newer" in str(w.message)],
    "q": stepper.q.tolist(), "threads": stepper.threads, "obs": obs.tolist(),
    "rewards": rewards.tolist(), "ended": ended.tolist(),
    "vector code": "dynamics.backends.numba_llvm.vector_code" in sys.modules,
}))
"""


def session(version: str, folder: Path) -> dict[str, Any]:
    result = subprocess.run(
        [sys.executable, "-c", SESSION, version],
        cwd=ROOT, check=True, capture_output=True, text=True,
        env=os.environ | {"FLEXARM_CACHE": str(folder)},
    )  # fmt: skip
    return json.loads(result.stdout)


def test_a_newer_numba_warns_and_steps_the_same_to_round_off(tmp_path: Path) -> None:
    tested, newer = session(numba.__version__, tmp_path / "a"), session("99.1.0", tmp_path / "b")
    assert tested["warned"] == []
    (warning,) = newer["warned"]
    assert "numba 99.1.0 is newer than flexarm was tested with" in warning
    assert tested["vector code"]
    assert not newer["vector code"]
    assert newer["threads"] == 1
    assert not list((tmp_path / "b").rglob("*.nbc"))
    for name in ("q", "obs", "rewards"):
        np.testing.assert_allclose(newer[name], tested[name], rtol=1e-6, atol=1e-12)
    assert newer["ended"] == tested["ended"]


def test_only_one_module_imports_private_parts() -> None:
    """`numba.core` is private; `numba`, `numba.extending` and `llvmlite.ir` are documented."""
    public = re.compile(r"(numba(\.extending|\.types|\.config)?|llvmlite\.(ir|binding))(\.\w+)?$")
    for path in sources("dynamics", "flexarm_env", "agents", "benchmarks"):
        found = imported(path)
        private = {x for x in found if x.startswith(("numba", "llvmlite")) and not public.match(x)}
        assert not private or str(path.relative_to(ROOT)) in ALLOWED, (path, private)


def test_the_newest_tested_release_is_the_pinned_one() -> None:
    (pinned,) = re.findall(r"^numba==(\d+)\.(\d+)", (ROOT / "constraints.txt").read_text(), re.M)
    assert tuple(map(int, pinned)) == NEWEST


def test_kept_code_depends_on_the_files_beside_its_own(tmp_path: Path) -> None:
    """It holds the code of functions of the folder that it calls."""
    (tmp_path / "calls.py").write_text("1")
    (tmp_path / "called.py").write_text("2")
    before = _sources(tmp_path)
    _sources.cache_clear()
    assert _sources(tmp_path) == before
    (tmp_path / "called.py").write_text("3")
    _sources.cache_clear()
    assert _sources(tmp_path) != before


@pytest.mark.parametrize(
    ("version", "usable"),
    [("0.62.0", True), ("0.68.9", True), ("0.69.0rc1", False), ("0.100.0", False), ("1.0", False)],
)
def test_releases_are_compared_as_numbers(version: str, usable: bool) -> None:
    assert _usable(version) == usable
