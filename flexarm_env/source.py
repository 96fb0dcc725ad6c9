"""The generated module of an environment, for `python -m dynamics source ARM --env ID`."""

from dynamics.backends.numba_llvm.program import generate
from dynamics.load import ArmSource
from flexarm_env.core import Core
from flexarm_env.registration import IDS, registered


def text(arm: ArmSource, env_id: str) -> str:
    """Text of the module that a batch of an id runs, with another arm in place of the id's own."""
    keywords = {**IDS[registered(env_id)]["kwargs"], "arm": arm}
    core = Core(**keywords, n_env=2)
    return generate(
        core.model.traced,
        core.model.dtype,
        core.model.lanes,
        core.integrator,
        core.signals.addition,
    )
