"""Agreement of the formulations, and the error of each convention for a bent tip's rotation.

    python -m benchmarks.accuracy.formulations [--out FILE]

Differences of M are relative to sqrt(M_jj M_kk). Differences of forces and accelerations are
relative to their own size, both in the norm of kinetic energy, sqrt(a' M a).
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.arms import undamped
from benchmarks.output import argument_parser, paragraphs, provenance, save_results, table
from benchmarks.speed.operations import Case, given_arm
from dynamics import ARMS, Arm, Mode, compile_arm, simulate
from dynamics.formulations.kinematics import Chain
from dynamics.formulations.table import FORMULATIONS, why_not
from dynamics.types import Array

ROTATIONS = ("exp", "linear")
SLOPES = (0.001, 0.01, 0.1)  # [rad] largest tip slope
STATES = 5  # per arm
RATE = 20.0  # [1/s] modal rates per amplitude
TIMES = (0.25, 0.5, 1.0, 2.0)  # [s]
CONVENTIONS = {
    "exp": ("gibbs_appell", "exp"),
    "linear, theta_dot": ("gibbs_appell", "linear"),
    "linear, E_dot": ("book", "linear"),
}


def conservative(arm: Arm) -> Arm:
    """The arm without damping and friction, so that its energy is constant."""
    arm = undamped(arm)
    joints = [replace(link.joint, viscous=0.0, coulomb=0.0) for link in arm.links]
    links = (replace(link, joint=x) for link, x in zip(arm.links, joints, strict=True))
    return replace(arm, links=tuple(links))


def planar_arm() -> Arm:
    """Two soft links in the plane, each with two modes."""
    arm = ARMS["deluca-siciliano"]
    modes = tuple(Mode(kind="clamped-tip-mass", index=k, direction="y") for k in (1, 2))
    links = tuple(replace(link, modes=modes) for link in arm.links)
    return conservative(replace(arm, links=links, foreshortening=False))


def spatial_arm() -> Arm:
    """Two links of the six-link preset that bend both ways and twist, under gravity."""
    return conservative(given_arm(Case(2, 2, 3)))


def state(chain: Chain, slope: float, seed: int) -> tuple[Array, Array]:
    """Random posture and rates; each link's amplitudes are scaled to this tip slope [rad]."""
    rng = np.random.default_rng(seed)
    q, v = [], []
    for link in chain.links:
        if not link.welded:
            q.append(rng.uniform(-np.pi, np.pi))
            v.append(rng.normal(0.0, 2.0))
        x = rng.uniform(-1.0, 1.0, (2, len(link.K)))
        for amplitudes, coordinates, size in zip(x, (q, v), (1.0, RATE), strict=True):
            theta = amplitudes @ np.array(link.tip_theta).reshape(-1, 3)
            turned = np.linalg.norm(theta) if len(amplitudes) else 1.0
            coordinates += list(amplitudes * (size * slope / turned))
    return np.array(q), np.array(v)


class Answer:
    """M, h and accelerations by one formulation at a state without torque, on plain floats."""

    def __init__(self, name: str, chain: Chain, q: Array, v: Array) -> None:
        formulation = FORMULATIONS[name]
        x, rates = [float(a) for a in q], [float(a) for a in v]
        rest = [0.0] * sum(not link.welded for link in chain.links)
        self.M = np.array(formulation.equations.mass_matrix(chain, x), dtype=np.float64)
        self.h = np.array(formulation.equations.bias(chain, x, rates), dtype=np.float64)
        self.a = np.array(formulation.accelerations(chain, x, rates, rest), dtype=np.float64)
        self.formulation, self.chain, self.q, self.v = formulation, chain, q, v

    @property
    def power(self) -> float:
        """Power that an undamped arm gains without torque, over the power of inertia [-]."""
        t = ca.SX.sym("t")
        moved, rates = (
            [float(x) + t * float(y) for x, y in zip(*pair, strict=True)]
            for pair in ((self.q, self.v), (self.v, self.a))
        )
        total = sum(self.formulation.energies(self.chain, moved, rates))
        gained = float(ca.Function("power", [t], [ca.jacobian(total, t)])(0.0))
        return abs(gained) / (_length(self.v, self.M) * _length(self.a, self.M))

    def differences(self, other: "Answer") -> dict[str, float]:
        """Relative differences of M, h and accelerations from another answer."""
        size = np.sqrt(np.diag(other.M))
        h = np.linalg.solve(other.M, np.array([self.h - other.h, other.h]).T).T
        return {
            "M": float(np.abs((self.M - other.M) / np.outer(size, size)).max()),
            "h": _length(h[0], other.M) / _length(h[1], other.M),
            "a": _length(self.a - other.a, other.M) / _length(other.a, other.M),
        }


def _length(a: Array, M: Array) -> float:
    return float(np.sqrt(a @ M @ a))


def worst(rows: list[dict[str, float]]) -> dict[str, float]:
    """Largest value of every column."""
    return {key: max(row[key] for row in rows) for key in rows[0]}


def agreement() -> Iterator[dict[str, Any]]:
    """Other formulations compared with Gibbs-Appell on presets and spatial arms, per rotation."""
    every = [replace(a, foreshortening=bool(a.foreshortening)) for a in ARMS.values()]
    presets = [a for a in every if not any(why_not(a, name) for name in FORMULATIONS)]
    arms = [*presets, spatial_arm(), given_arm(Case(6, 2, 3)), given_arm(Case(6, 6, 3))]
    for rotation in ROTATIONS:
        chains = [compile_arm(replace(conservative(arm), rotation=rotation)).chain for arm in arms]
        states = [(chain, *state(chain, 0.1, k)) for chain in chains for k in range(STATES)]
        answers = {name: [Answer(name, *s) for s in states] for name in FORMULATIONS}
        for name in FORMULATIONS:
            if name == "gibbs_appell":
                continue
            pairs = zip(answers[name], answers["gibbs_appell"], strict=True)
            yield {
                "rotation": rotation, "formulation": name, "states": len(states),
                **worst([other.differences(recursion) for other, recursion in pairs]),
            }  # fmt: skip


def conventions() -> Iterator[dict[str, Any]]:
    """Linear conventions compared with the exact rotation, over amplitudes."""
    for kind, arm in (("planar", planar_arm()), ("spatial", spatial_arm())):
        chains = {r: compile_arm(replace(arm, rotation=r)).chain for r in ROTATIONS}
        for slope in SLOPES:
            states = [state(chains["exp"], slope, k) for k in range(STATES)]
            found = {
                convention: [Answer(name, chains[rotation], q, v) for q, v in states]
                for convention, (name, rotation) in CONVENTIONS.items()
            }
            for convention, answers in found.items():
                pairs = zip(answers, found["exp"], strict=True)
                rows = [answer.differences(exact) for answer, exact in pairs]
                yield {"arm": kind, "slope [rad]": slope, "convention": convention} | {
                    **worst(rows),
                    "energy gained": max(x.power for x in answers),
                }


def motions() -> Iterator[dict[str, Any]]:
    """Tip distance and energy drift after release at rest with tip slopes of 0.1 rad, no torque."""
    for kind, arm in (("planar", planar_arm()), ("spatial", spatial_arm())):
        exact = None
        for rotation in ROTATIONS:
            for name in FORMULATIONS:
                model = compile_arm(replace(arm, rotation=rotation), formulation=name)
                q, _ = state(model.chain, 0.1, 0)
                run = simulate(model, q, 0.0 * q, None, [0.0, *TIMES], rtol=1e-11)
                energies = [sum(model.energy(q, v)) for q, v in zip(run.q, run.v, strict=True)]
                exact = run.tip if exact is None else exact
                apart = np.linalg.norm(run.tip - exact, axis=1)
                yield {
                    "arm": kind, "rotation": rotation, "formulation": name,
                    "tips apart [m]": apart[1:].tolist(),
                    "energy drift [J]": float(np.abs(np.array(energies) - energies[0]).max()),
                }  # fmt: skip


# ---- page ----------------------------------------------------------------------------------------


def _table(rows: list[dict[str, Any]]) -> str:
    return table(list(rows[0]), ([_cell(value) for value in row.values()] for row in rows))


def _cell(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(_cell(x) for x in value)
    return f"{value:.1e}" if isinstance(value, float) else str(value)


def page(result: dict[str, Any]) -> str:
    """The results as Markdown."""
    return paragraphs(
        "# Formulations compared",
        f"Made by `{result['command']}`. Largest relative differences over several states; what "
        "they mean: [formulations](../formulations.md).",
        "## Beside the Gibbs-Appell recursion, tip slopes of 0.1 rad",
        _table(result["agreement"]),
        "## Conventions beside the true rotation",
        _table(result["conventions"]),
        f"## Motion: tips apart after {', '.join(map(str, TIMES))} s from the first row, "
        "integrated at rtol 1e-11",
        _table(result["motion"]),
    )


def main() -> None:
    """Measure, and write JSON and the page."""
    parser = argument_parser("accuracy.formulations", __doc__, "formulations.json")
    out = parser.parse_args().out
    result = {
        **provenance("casadi", "numpy", "scipy"),
        "agreement": list(agreement()),
        "conventions": list(conventions()),
        "motion": list(motions()),
    }
    save_results(result, page, out)


if __name__ == "__main__":
    main()
