"""Batches of environments, stepped by one compiled call on several threads."""

from collections.abc import Callable
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynamics.description import validate
from dynamics.integrators.table import INTEGRATORS
from dynamics.model import Model
from dynamics.runtime.numba_internals import compiled_for
from dynamics.runtime.thread_pool import ThreadPool, in_use, useful_threads
from dynamics.runtime.work_queue import shares

MOST_ENVIRONMENTS = 1_000_000
MOST_SUBSTEPS = 1_000_000_000
MOST_THREADS = 1024


class Stepper:
    """A batch of environments of one arm, stepped together.

    `q`, `v` and `torque` may be written between calls. In a batch, the motion of an environment is
    bit for bit independent of the batch size, the number of threads and its lane. A single
    environment uses the one-lane program, which agrees to round-off.

    Parameters
    ----------
    model : the compiled arm; shared, never changed.
    n_env : number of environments.
    dt : [s] integration step.
    substeps : steps per call of `advance`, under constant torque.
    integrator : a name in `dynamics.integrators.table.INTEGRATORS`.
    threads : greatest number of worker threads; a batch with too little work uses fewer.

    All but `dt` and `substeps` are fixed from then on.

    Attributes
    ----------
    q, v : (n_env, n) coordinates and their rates; [rad], [m].
    torque : (n_env, n_torque) [N m].
    parameters : (n_env, n_parameter) the model's free parameters, nominal at first.
    status : (n_env,) 0, or the substep at which the environment became non-finite. Such an
        environment keeps its state and measurements of before the call.
    measured : (n_env, n_measure) measurements; `model.measurements` names the columns.
    """

    def __init__(
        self,
        model: Model,
        n_env: int,
        *,
        dt: float,
        substeps: int,
        integrator: str = "rk4",
        threads: int = 1,
    ) -> None:
        validate.instance(model, "model", Model)
        validate.known(integrator, "integrator", INTEGRATORS)
        self._n_env = validate.integer(n_env, "n_env", 1, MOST_ENVIRONMENTS)
        self.substeps, self.dt = substeps, dt
        threads = validate.integer(threads, "threads", 1, MOST_THREADS)
        self._model, self._integrator = model, integrator
        self._q, self._v = np.zeros((self.n_env, model.n)), np.zeros((self.n_env, model.n))
        self._torque = np.zeros((self.n_env, model.n_torque))
        self._parameters = np.tile(model.nominal_parameters, (self.n_env, 1))
        self._status = np.zeros(self.n_env, dtype=np.int64)
        self._measured = np.zeros((self.n_env, model.n_measure))
        self._program = model.program(1 if self.n_env == 1 else model.lanes, integrator)
        evaluations = INTEGRATORS[integrator].evaluations(self.substeps)
        operations = self.n_env * evaluations * int(self._program.OPERATIONS)
        self._threads = useful_threads(threads, -(-self.n_env // model.lanes), operations)
        self._shares = shares(self.n_env, model.lanes, self.threads)
        self._rows = self._shares.copy()
        self._w = [model.workspace(self._program) for _ in range(self.threads)]
        self._pool = ThreadPool(self.threads)
        self._lock = Lock()

    @property
    def dt(self) -> float:
        """[s] integration step; another may be set."""
        return self._dt

    @dt.setter
    def dt(self, value: float) -> None:
        self._dt = validate.positive(value, "dt", "s")

    @property
    def substeps(self) -> int:
        """Steps per call of `advance`; another number may be set."""
        return self._substeps

    @substeps.setter
    def substeps(self, value: int) -> None:
        self._substeps = validate.integer(value, "substeps", 1, MOST_SUBSTEPS)

    # read-only properties: compiled code relies on them, and on the shapes and types of the arrays
    model = property(lambda self: self._model)
    n_env = property(lambda self: self._n_env)
    integrator = property(lambda self: self._integrator)
    threads = property(lambda self: self._threads)
    q = property(lambda self: self._q)
    v = property(lambda self: self._v)
    torque = property(lambda self: self._torque)
    parameters = property(lambda self: self._parameters)
    status = property(lambda self: self._status)
    measured = property(lambda self: self._measured)

    def advance(self) -> None:
        """Step every environment `substeps` times, then measure. Allocates nothing.

        Raises
        ------
        RuntimeError : while another thread steps the batch.
        """
        if not self._lock.acquire(blocking=False):
            raise in_use()
        try:
            if self.threads == 1:
                self._advance(0)
            else:
                self._rows[:] = self._shares
                self._compiled  # compile on this thread, before the others call it  # noqa: B018
                self._pool.run(self._advance)
        finally:
            self._lock.release()

    def _advance(self, thread: int) -> None:
        self._compiled(
            self._rows, thread, self._q, self._v, self._torque, self._parameters, self.dt,
            self.substeps, self._w[thread], self._status, self._measured,
        )  # fmt: skip

    @cached_property
    def _compiled(self) -> Callable[..., Any]:
        return compiled_for(
            self._program.advance, self._rows, 0, self._q, self._v, self._torque, self._parameters,
            self.dt, self.substeps, self._w[0], self._status, self._measured,
        )  # fmt: skip

    def measure(self, q: ArrayLike, v: ArrayLike, out: NDArray[np.float64]) -> None:
        """Write the measurements (N, n_measure) of states q, v (N, n) into `out`.

        Another thread may step the batch meanwhile.
        """
        q, v = (validate.array(x, name, (None, self.model.n)) for x, name in ((q, "q"), (v, "v")))
        shape = len(q), self.model.n_measure
        validate.instance(out, "out", np.ndarray)
        if v.shape != q.shape or out.shape != shape or out.dtype != np.float64:
            raise ValueError(
                f"v must have the shape {q.shape} of q, and out must be float64 of shape {shape}, "
                f"got {v.shape} and {out.dtype} of shape {out.shape}."
            )
        self._program.measure_states(q, v, self.model.workspace(self._program), out)
