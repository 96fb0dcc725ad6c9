"""Entry points are compiled once, kept on disk, and quick to load."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynamics.runtime.jit import on_disk
from dynamics.runtime.numba_internals import compiled_for
from tests.paths import ROOT

SESSION = """
import json, sys
import numpy as np
from dynamics import Stepper, compile_arm
model = compile_arm("slim")
stepper = Stepper(model, 20, dt=1e-4, substeps=2)
stepper.advance()
model.inverse_dynamics(*np.zeros((3, 20, model.n)))
entries = stepper._program.advance, model._forces_program.forces_of_states
slow = {"casadi", "scipy.linalg", "numba.np.arraymath", "dynamics.arms.presets.six_link"}
print(json.dumps({
    "slow": sorted(slow & set(sys.modules)),
    "hits": sum(sum(entry.stats.cache_hits.values()) for entry in entries),
    "misses": sum(sum(entry.stats.cache_misses.values()) for entry in entries),
}))
"""


def test_a_second_process_starts_from_the_cache(tmp_path: Path) -> None:
    """It neither traces nor compiles nor writes, nor imports what only those need."""

    def session() -> dict[str, Any]:
        result = subprocess.run(
            [sys.executable, "-c", SESSION], cwd=ROOT, check=True, capture_output=True, text=True,
            env=os.environ | {"FLEXARM_CACHE": str(tmp_path)},
        )  # fmt: skip
        return json.loads(result.stdout)

    def files() -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}

    cold = session()
    written = files()
    warm = session()

    compiler = ["casadi", "numba.np.arraymath", "scipy.linalg"]
    assert cold == {"slow": compiler, "hits": 0, "misses": 2}
    assert warm == {"slow": [], "hits": 2, "misses": 0}
    assert any(path.suffix == ".nbc" for path in written)
    assert files() == written


def mean(x: Any, scale: float) -> Any:
    return scale * x.sum() / x.size


def test_compiled_for_gives_the_function_that_numba_would_dispatch_to() -> None:
    """Compiled once for arguments of these types; numbers of another size are refused."""
    found, x = on_disk()(mean), np.arange(5.0)
    called = compiled_for(found, x, 2.0)
    assert compiled_for(found, x[:3], 1.0) is called
    assert called(x, 0.5) == found(x, 0.5) == 1.0
    assert len(found.overloads) == 1
    with pytest.raises(TypeError, match="array"):
        called(x.astype(np.float32), 0.5)
