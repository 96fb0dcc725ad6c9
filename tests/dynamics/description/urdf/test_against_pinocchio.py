"""Converted robots against Pinocchio, which reads the same files with a parser of its own."""

from pathlib import Path

import numpy as np
import pytest

from dynamics import Arm, Model
from dynamics.formulations import gibbs_appell
from dynamics.formulations.newton_euler import inverse_dynamics, rigid_links
from dynamics.types import Array
from tests.dynamics.agreement import accelerations
from tests.dynamics.description.urdf.robots import PUBLIC, assert_close, loaded, public
from tests.dynamics.random_arms import compiled, floats

pin = pytest.importorskip("pinocchio", reason="pin (extra `test`) has no wheel for this platform")

RANDOM = range(12)


def text_of(robot: str | int) -> str:
    if isinstance(robot, int):
        return random_robot(robot)
    return public(robot).read_text(encoding="utf-8")


def random_robot(seed: int) -> str:
    """Tree of turned inertias and joints in any direction, with branches and fixed links."""
    rng = np.random.default_rng([seed, 77])
    parts = ['<link name="base"/>']
    chain, names = "base", ["base"]
    for k in range(2 + seed % 5):
        chain = grown(rng, parts, chain, f"link{k}", str(rng.choice(MOVING)))
        names.append(chain)
        for j in range(rng.integers(0, 3)):
            kind = str(rng.choice(["fixed", *MOVING]))
            names.append(grown(rng, parts, str(rng.choice(names)), f"side{k}-{j}", kind))
        if rng.random() < 0.4:
            chain = grown(rng, parts, chain, f"welded{k}", "fixed")
            names.append(chain)
    grown(rng, parts, chain, "tip", "fixed")
    rng.shuffle(parts)
    return f'<robot name="random {seed}">\n' + "\n".join(parts) + "\n</robot>"


MOVING = ("revolute", "continuous", "prismatic")


def grown(rng: np.random.Generator, parts: list[str], parent: str, name: str, kind: str) -> str:
    """Add a link behind a joint; returns its name."""
    root = rng.normal(0.0, 0.2, (3, 3))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (root @ root.T).tolist()
    parts.append(
        f'<link name="{name}"><inertial>{place(rng)}<mass value="{rng.uniform(0.2, 3.0)!r}"/>'
        f'<inertia ixx="{xx!r}" ixy="{xy!r}" ixz="{xz!r}" iyy="{yy!r}" iyz="{yz!r}" izz="{zz!r}"/>'
        "</inertial></link>"
    )
    axis = f'<axis xyz="{words(rng.normal(size=3))}"/>' if rng.random() < 0.8 else ""
    parts.append(
        f'<joint name="to {name}" type="{kind}">{place(rng)}<parent link="{parent}"/>'
        f'<child link="{name}"/>{axis}'
        f'<limit effort="1" velocity="1" lower="-1" upper="1"/>'
        f'<dynamics damping="{rng.uniform(0.0, 2.0)!r}" friction="{rng.uniform(0.0, 1.0)!r}"/>'
        "</joint>"
    )
    return name


def place(rng: np.random.Generator) -> str:
    xyz, rpy = rng.normal(0.0, 0.3, 3), rng.uniform(-3.0, 3.0, 3)
    return f'<origin xyz="{words(xyz)}" rpy="{words(rpy)}"/>'


def words(values: Array) -> str:
    return " ".join(map(repr, values.tolist()))


class Other:
    """Pinocchio's model of the chain to a tip, with the joints beside it held at zero."""

    def __init__(self, text: str, tip: str) -> None:
        whole = pin.buildModelFromXML(text)
        moving = whole.supports[whole.frames[whole.getFrameId(tip)].parentJoint]
        held = [i for i in range(1, whole.njoints) if i not in list(moving)]
        self.model = pin.buildReducedModel(whole, held, pin.neutral(whole))
        self.data = self.model.createData()
        self.tip = self.model.getFrameId(tip)

    def configuration(self, q: Array) -> Array:
        """Continuous joints have the cosine and the sine of their angle."""
        joints = list(self.model.joints)[1:]
        pairs = zip(joints, q, strict=True)
        return np.concatenate(
            [[np.cos(x), np.sin(x)] if joint.nq == 2 else [x] for joint, x in pairs]
        )

    def mass_matrix(self, q: Array) -> Array:
        upper = np.triu(pin.crba(self.model, self.data, self.configuration(q)))
        return upper + np.triu(upper, 1).T

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """Without friction, which Pinocchio reads and leaves to its caller."""
        return pin.rnea(self.model, self.data, self.configuration(q), v, a)

    def tip_at(self, q: Array) -> Array:
        pin.framesForwardKinematics(self.model, self.data, self.configuration(q))
        return self.data.oMf[self.tip].translation


@pytest.fixture(params=[*PUBLIC, *RANDOM], ids=str)
def pair(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Arm, Other]:
    return both(request.param, tmp_path)


def both(robot: str | int, folder: Path) -> tuple[Arm, Other]:
    text, tip = text_of(robot), PUBLIC.get(str(robot), "tip")
    return loaded(folder, text, tip=tip), Other(text, tip)


def friction(other: Other, v: Array) -> Array:
    """Torque of the file's damping and friction, the latter smoothed as `Joint` has it."""
    model = other.model
    return model.damping * v + model.upperDryFrictionLimit * np.tanh(v / 0.05)


def motion(n: int, seed: int) -> tuple[Array, Array, Array]:
    return tuple(np.random.default_rng([seed, n, 3]).normal(0.0, 1.5, (3, n)))


def test_mass_matrix_torques_and_tip_are_pinocchios(pair: tuple[Arm, Other]) -> None:
    """Gravity alone, then a motion with friction, by both recursions."""
    arm, other = pair
    (q, v, a), model = motion(arm.n, 0), Model(arm)
    zero, chain = np.zeros(arm.n), model.chain

    assert_close(gibbs_appell.mass_matrix(chain, floats(q)), other.mass_matrix(q))
    weight = other.torque(q, zero, zero)
    assert_close(gibbs_appell.bias(chain, floats(q), floats(zero)), weight)
    expected = other.torque(q, v, a) + friction(other, v)
    assert_close(model.inverse_dynamics(q, v, a), expected)
    found = inverse_dynamics(rigid_links(arm), floats(q), floats(v), floats(a), gravity=arm.gravity)
    assert_close(found, expected)
    assert_close(model.tip(q), other.tip_at(q))


def test_accelerations_are_pinocchios(pair: tuple[Arm, Other]) -> None:
    arm, other = pair
    q, v, tau = motion(arm.n, 1)
    rest = tau - friction(other, v)
    expected = pin.aba(other.model, other.data, other.configuration(q), v, rest)

    found = accelerations(arm, q, v, tau)

    M = other.mass_matrix(q)
    assert_close(found, expected)
    assert np.linalg.cond(M) < 1e5


@pytest.mark.parametrize("robot", PUBLIC)
def test_compiled_accelerations_are_pinocchios(robot: str, tmp_path: Path) -> None:
    arm, other = both(robot, tmp_path)
    q, v, tau = motion(arm.n, 2)
    rest = tau - friction(other, v)
    expected = pin.aba(other.model, other.data, other.configuration(q), v, rest)
    assert_close(compiled(arm).accelerations(q, v, tau), expected)


def test_random_robots_have_branches_slides_and_friction(tmp_path: Path) -> None:
    texts = [random_robot(seed) for seed in RANDOM]
    arms = [both(seed, tmp_path)[0] for seed in RANDOM]
    assert {link.joint.type for arm in arms for link in arm.links} == {"revolute", "prismatic"}
    assert all(link.joint.coulomb > 0.0 for arm in arms for link in arm.links)
    assert sum(text.count('type="fixed"') for text in texts) > len(texts)
    assert any(text.count("<joint") > arm.n + 2 for text, arm in zip(texts, arms, strict=True))
