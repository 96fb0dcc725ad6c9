"""Many substeps, many environments, all cores: one compiled call."""

import numpy as np

from dynamics.crew import Crew, worth
from dynamics.integrators import INTEGRATORS
from dynamics.model import Model
from dynamics.sharing import turns


class Stepper:
    """A batch of environments of one arm, stepped together.

    Write into `q`, `v` and `torque` freely between calls. What an environment does depends
    neither on the size of the batch nor on threads or lane. A single environment uses the one-lane
    instance of the same code, equal to round-off.

    Parameters
    ----------
    model : the compiled arm; shared, never changed.
    n_env : number of environments.
    dt : [s] integration step.
    substeps : steps per call of `advance`, under constant torque.
    integrator : a name in `dynamics.integrators.INTEGRATORS`.
    threads : worker threads at most; a batch with too little work for them takes fewer.

    Attributes
    ----------
    q, v : (n_env, n) coordinates and their rates; [rad], [m].
    torque : (n_env, n_joint) [N m].
    parameters : (n_env, n_parameter) the model's free parameters, nominal at first.
    status : (n_env,) 0, or the substep at which the environment went non-finite. Such an
        environment keeps the state and measurements it had before the call.
    measured : (n_env, n_measure) columns by `model.measurements`.
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
        if integrator not in INTEGRATORS:
            raise ValueError(f"Unknown integrator {integrator!r}. Known: {sorted(INTEGRATORS)}.")
        for name, value in (("n_env", n_env), ("substeps", substeps), ("threads", threads)):
            if not isinstance(value, int | np.integer) or value < 1:
                raise ValueError(f"{name} must be a positive integer, got {value!r}.")
        if not (np.isfinite(dt) and dt > 0.0):
            raise ValueError(f"dt must be positive and finite, got {dt!r}. Unit: [s].")
        self.model, self.n_env, self.integrator = model, int(n_env), integrator
        self.dt, self.substeps = float(dt), int(substeps)
        self.q = np.zeros((n_env, model.n))
        self.v = np.zeros((n_env, model.n))
        self.torque = np.zeros((n_env, model.n_joint))
        self.parameters = np.tile(model.nominal_parameters, (n_env, 1))
        self.status = np.zeros(n_env, dtype=np.int64)
        self.measured = np.zeros((n_env, model.n_measure))
        self._program = model.program(1 if n_env == 1 else model.lanes, integrator)
        evaluations = INTEGRATORS[integrator].evaluations(self.substeps)
        operations = self.n_env * evaluations * int(self._program.OPERATIONS)
        self.threads = worth(int(threads), -(-self.n_env // model.lanes), operations)
        self._turns = turns(self.n_env, model.lanes, self.threads)
        self._rows = self._turns.copy()
        self._w = [model.workspace(self._program) for _ in range(self.threads)]
        self._crew = Crew(self.threads)

    def advance(self) -> None:
        """Step every environment `substeps` times, then measure. Allocates nothing."""
        if self.threads == 1:
            self._advance(0)
        else:
            self._rows[:] = self._turns
            self._crew.run(self._advance)

    def _advance(self, thread: int) -> None:
        self._program.advance(
            self._rows, thread, self.q, self.v, self.torque, self.parameters, self.dt,
            self.substeps, self._w[thread], self.status, self.measured,
        )  # fmt: skip

    def measure(self, q: np.ndarray, v: np.ndarray, out: np.ndarray) -> None:
        """Measurements (N, n_measure) of any states (N, n), by this stepper's compiled code."""
        self._program.measure_states(q, v, self._w[0], out)
