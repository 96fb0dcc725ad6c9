"""Choices of `choose_model` on contrasting scenes, and verification of their claimed errors.

    python -m benchmarks.accuracy.model_choice [--out docs/results/model_choice.json] [--truth]

Writes the ladders as JSON and as a Markdown page beside it. Each claim is verified by compiling the
chosen model, integrating it with the chosen step, and comparing its tip with another discretisation
of the arm, integrated by SciPy's DOP853. Those reference motions take minutes and are stored in
tests/reference/; `--truth` recomputes them.
"""

import json
import math
import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.arms import ACROSS
from benchmarks.output import REFERENCE, argument_parser, paragraphs, provenance, save_results
from dynamics import Arm, Choice, Joint, Link, Mode, Scene, choose_model, compile_arm, simulate
from dynamics.accuracy.fidelity import everything
from dynamics.accuracy.scene import JointMotion, bang_bang, cycloid, release
from dynamics.types import Array

TRUTH = REFERENCE / "model_choice_truth.json"
TRUTH_SAMPLES = 97


@dataclass(frozen=True)
class Trial:
    """An arm, a scene, a tolerance, and an independent model that is converged on the scene."""

    arm: Arm
    scene: Scene
    tolerance: float  # [m]
    kind: str  # kind of the independent model's bending modes
    modes: int  # number of those modes per direction
    segments: int = 1  # of each link of the independent model


@dataclass(frozen=True)
class SpinUp:
    """Torque that accelerates a rotor smoothly from rest to 6 rad/s in 15 s."""

    inertia: float  # [kg m^2]

    def __call__(self, t: float) -> list[float]:
        rate = 0.4 * (1.0 - math.cos(2.0 * math.pi * t / 15.0)) if t < 15.0 else 0.0
        return [self.inertia * rate]

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """End of the torque [s]."""
        return (15.0,)


def _one(rotor: float, gravity: tuple[float, float, float] = (0.0, 0.0, 0.0), **link: float) -> Arm:
    joint = Joint(rotor_inertia=rotor)
    return Arm(links=(Link(**link, modes=(), joint=joint),), gravity=gravity)  # type: ignore[arg-type]


def _scene(name: str, motion: JointMotion) -> Scene:
    return Scene(name=name, motions=(motion,))


def _two(second: Joint) -> Arm:
    link = Link(length=0.6, rho_A=0.8, EIz=80.0, EIy=80.0, tip_mass=0.3, modes=())
    first = replace(link, tip_mass=0.5, joint=Joint(rotor_inertia=0.3))
    return Arm(links=(first, replace(link, joint=second)))


S1 = _one(0.01, length=1.2192, rho_A=0.245, EIz=11.82, tip_mass=0.0404)
MIXED = Arm(
    links=(
        Link(
            length=0.7, rho_A=2.0, EIz=5e4, tip_mass=0.3, modes=(), joint=Joint(rotor_inertia=0.1)
        ),
        Link(
            length=0.8, rho_A=0.2, EIz=8.0, tip_mass=0.05, modes=(), joint=Joint(rotor_inertia=0.02)
        ),
    )
)
CRANK = Arm(
    gravity=(0.0, 0.0, -9.81),
    links=(
        Link(length=0.6, rho_A=1.0, GJ=60.0, rho_Ip=1e-3, modes=(), joint=Joint(rotor_inertia=5.0)),
        Link(length=0.5, rho_A=0.5, tip_mass=1.0, joint=Joint(rotor_inertia=5.0)),
    ),
)
SPATIAL = _two(Joint(rotor_inertia=0.1, rotation=ACROSS))

TRIALS = {
    trial.scene.name: trial
    for trial in (
        Trial(
            _one(0.01, length=0.5, rho_A=1.0, EIz=2000.0),
            _scene("stiff link", bang_bang((0.5,), pulse=0.2, t_end=0.6)),
            1e-3, "clamped-free", 3,
        ),
        Trial(
            _one(2.0, length=1.0, rho_A=0.5, EIz=60.0, tip_mass=0.3),
            _scene("heavy hub", cycloid((6.0,), duration=0.5, t_end=1.0)),
            1e-3, "poly", 4,
        ),
        Trial(
            _one(0.002, length=1.2, rho_A=0.25, EIz=12.0),
            _scene("light hub", bang_bang((0.25,), pulse=0.2, t_end=1.0)),
            1e-3, "poly", 2, 6,
        ),
        Trial(
            S1, _scene("laboratory arm", bang_bang((0.5,), pulse=0.25, t_end=2.0)),
            1.2e-3, "poly", 2, 6,
        ),
        Trial(
            MIXED, _scene("stiff and flexible link", bang_bang((2.0, 0.5), pulse=0.2, t_end=0.8)),
            1.5e-3, "poly", 2, 3,
        ),
        Trial(
            _one(1e6, length=10.0, rho_A=1.2, EIz=1.4e4),
            _scene(
                "fast spin",
                JointMotion(
                    joint_angles=(0.0,), joint_rates=(0.0,), t_end=18.0, torque=SpinUp(1e6 + 400.0)
                ),
            ),
            0.05, "poly", 2, 4,
        ),
        Trial(
            _one(50.0, (0.0, -9.81, 0.0), length=1.0, rho_A=0.2, EIz=1.0),
            _scene("soft beam", release((0.0,), t_end=0.5)),
            5e-3, "poly", 2, 12,
        ),
        Trial(
            SPATIAL, _scene("spatial, both joints", bang_bang((3.0, 2.0), pulse=0.1, t_end=0.3)),
            8e-3, "poly", 2, 2,
        ),
        Trial(
            SPATIAL, _scene("spatial, one joint", bang_bang((3.0, 0.0), pulse=0.1, t_end=0.3)),
            8e-3, "poly", 2, 2,
        ),
        Trial(
            CRANK, _scene("crank", release((0.0, 0.5 * math.pi), t_end=0.5)),
            1e-3, "poly", 0,
        ),
    )
}  # fmt: skip


def independent_tips(trial: Trial, motion: JointMotion, times: Array) -> Array:
    """(N, 3) [m] tip of the trial's independent model, without compiled code."""
    model = compile_arm(_independent_arm(trial))
    n, joints = model.n, list(model.arm.joint_index)
    x = np.zeros(2 * n)
    x[joints], x[[n + j for j in joints]] = motion.joint_angles, motion.joint_rates
    rows = [x[None]]
    for begin, end in zip(motion.knots[:-1], motion.knots[1:], strict=True):

        def derivative(t: float, x: Array, last: float = np.nextafter(end, begin)) -> Array:
            tau = np.zeros(model.n_joint) if motion.torque is None else motion.torque(min(t, last))
            a = model.graph(x[:n], x[n:], tau, [], [])
            return np.concatenate([x[n:], np.array(a).ravel()])

        inside = times[(times > begin) & (times <= end)]
        stops = np.union1d(inside, [end])
        solution = solve_ivp(
            derivative, (begin, end), rows[-1][-1] if begin == 0.0 else x, "DOP853", stops,
            rtol=1e-8, atol=1e-10,
        )  # fmt: skip
        x = solution.y[:, -1]
        rows.append(solution.y[:, : inside.size].T)
    return np.array([model.tip(row[:n]) for row in np.concatenate(rows)])


def _independent_arm(trial: Trial) -> Arm:
    counts = everything(trial.arm, trial.modes, 2)
    links = []
    for link, per_direction in zip(trial.arm.links, counts, strict=True):
        kinds = zip("yzx", (trial.kind, trial.kind, "torsion-poly"), per_direction, strict=True)
        modes = tuple(
            Mode(kind=kind, index=k, direction=direction)
            for direction, kind, count in kinds
            for k in range(1, count + 1)
        )
        links.append(replace(link, modes=modes, segments=trial.segments if modes else 1))
    return replace(trial.arm, links=tuple(links), foreshortening=True)


def chosen_tips(choice: Choice, motion: JointMotion, times: Array) -> Array:
    """(N, 3) [m] tip of the chosen model, compiled, with the chosen integrator and step."""
    model = compile_arm(choice.arm)
    q, v = np.zeros(model.n), np.zeros(model.n)
    q[list(model.arm.joint_index)] = motion.joint_angles
    v[list(model.arm.joint_index)] = motion.joint_rates
    return simulate(
        model, q, v, motion.torque, times, integrator=choice.integrator, dt=choice.dt
    ).tip


def truth_times(trial: Trial) -> Array:
    """(N,) [s] sample times of the independent motion."""
    return np.linspace(0.0, trial.scene.motions[0].t_end, TRUTH_SAMPLES)


def stored_truth() -> dict[str, Array]:
    """Stored tips of the independent models: scene -> (N, 3) [m]."""
    return {name: np.array(tips) for name, tips in json.loads(TRUTH.read_text()).items()}


def verified_error(trial: Trial, choice: Choice, truth: Array) -> float:
    """Largest distance between the tips of the chosen and the independent model [m]."""
    times = truth_times(trial)
    every = math.ceil(choice.dt / times[1] - 1e-9)  # no output time shortens a chosen step
    apart = chosen_tips(choice, trial.scene.motions[0], times[::every]) - truth[::every]
    return float(np.linalg.norm(apart, axis=1).max())


def _make_truth() -> None:
    result = {}
    for name, trial in TRIALS.items():
        tips = independent_tips(trial, trial.scene.motions[0], truth_times(trial))
        result[name] = [[round(x, 8) + 0.0 for x in tip] for tip in tips.tolist()]
        print(f"{name}: done", flush=True)
    TRUTH.write_text(json.dumps(result, separators=(",", ":")).replace('],"', ']\n,"') + "\n")


def main() -> None:
    """Run all trials, and write JSON and the page."""
    parser = argument_parser("accuracy.model_choice", __doc__, "model_choice.json")
    parser.add_argument("--truth", action="store_true", help="recompute the independent motions")
    options = parser.parse_args()
    if options.truth:
        _make_truth()
    truth = stored_truth()
    made = provenance("numpy", "scipy", "casadi")
    made_by = f"Made by `{made['command']}` on {made['machine']['processor']}."
    text = ["# Model choice: the ladders", made_by]
    results = []
    for name, trial in TRIALS.items():
        begin = time.process_time()
        choice = choose_model(trial.arm, trial.scene, trial.tolerance)
        seconds = time.process_time() - begin
        verified = verified_error(trial, choice, truth[name])
        results.append({**choice.to_dict(), "verified_error": verified, "cpu_seconds": seconds})
        text += [
            f"## {name[0].upper()}{name[1:]}", choice.reason, choice.table(),
            f"Reference: {choice.reference}. Verified error {verified:.2g} m of "
            f"{trial.tolerance:.2g} m allowed; {seconds:.1f} s.",
        ]  # fmt: skip
        print(name, flush=True)
    save_results(made | {"trials": results}, paragraphs(*text), options.out)


if __name__ == "__main__":
    main()
