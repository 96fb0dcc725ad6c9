"""The generated code of an environment, for `python -m dynamics source ARM --env ID`."""

from dynamics.backends.cuda import program as cuda
from dynamics.backends.numba_llvm import program as llvm
from dynamics.load import ArmSource
from flexarm_env.compiled.restart import restarting
from flexarm_env.core import Core
from flexarm_env.registration import IDS, registered


def text(arm: ArmSource, env_id: str, backend: str = "llvm") -> str:
    """Text of the code that a batch of an id runs, with another arm in place of the id's own.

    `backend` is "llvm", a module in float64, or "cuda", kernels in float32.
    """
    keywords = {**IDS[registered(env_id)]["kwargs"], "arm": arm}
    core = Core(**keywords, n_env=2, dtype="float64" if backend == "llvm" else "float32")
    traced, dtype, integrator = core.model.traced, core.model.dtype, core.integrator
    if backend == "cuda":
        return cuda.generate(traced, dtype, integrator, restarting(core.signals, core.starts)).text
    return llvm.generate(traced, dtype, core.model.lanes, integrator, core.signals.addition)
