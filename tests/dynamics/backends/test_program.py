"""The generated code: vectors, nothing wasted, nothing stale."""

import platform
import re
import shutil
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest

from dynamics import Arm, Joint, Link, Mode, Stepper, compile_arm, load_arm
from dynamics.backends.numba_llvm import fingerprint as keys
from dynamics.backends.numba_llvm.fingerprint import fingerprint
from dynamics.backends.numba_llvm.program import cached_module
from dynamics.backends.numba_llvm.stepper_entries import LANES
from dynamics.tracing import graphs
from dynamics.tracing import method as methods
from dynamics.tracing.method import traced_method
from dynamics.tracing.traced_arm import TracedArm
from tests.dynamics.random_arms import random_arm
from tests.paths import ROOT

X86 = platform.machine().lower() in ("x86_64", "amd64")
ARITHMETIC = r"\bv?(?:add|sub|mul|div|fn?m(?:add|sub)\d+)"


INERTIA = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.01))


def planar(n_link: int, name: str) -> Arm:
    """All in the x-y plane; a name of its own makes a program of its own."""
    modes = tuple(Mode(kind="clamped-free", index=k, direction="y") for k in (1, 2))
    link = Link(length=1.0, rho_A=2.0, EIz=50.0, tip_mass=0.5, modes=modes, tip_inertia=INERTIA)
    return Arm(links=(link,) * n_link, gravity=(0.0, -9.81, 0.0), name=name)


@pytest.fixture(scope="module", params=[1, 2], ids=["one link", "two links"])
def cold(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Stepper:
    """A batch whose code was compiled in this process: numba cannot show what it has cached."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXARM_CACHE", str(tmp_path_factory.mktemp("cold")))
        model = compile_arm(planar(request.param, "compiled here"))
        stepper = Stepper(model, 2 * LANES, dt=1e-4, substeps=2)
        stepper.advance()
        return stepper


@pytest.mark.skipif(not X86, reason="knows the names of x86 instructions only")
def test_steppers_do_their_arithmetic_on_vectors(cold: Stepper) -> None:
    """Packed instructions for the arm's own operations; the few scalar ones are the loops'."""
    (assembly,) = cold._program.advance.inspect_asm().values()
    flags = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""

    packed = re.findall(ARITHMETIC + r"pd\b.*", assembly)
    scalar = re.findall(ARITHMETIC + r"sd\b.*", assembly)

    operations = sum(cold.model.operation_count()["accelerations"].values())
    assert len(packed) > operations
    assert len(scalar) < operations  # lane by lane they would be 16 times as many
    if " avx2 " in flags:
        wide = [line for line in packed if "%ymm" in line or "%zmm" in line]
        assert len(wide) > 0.9 * len(packed)


def test_little_is_compiled_beside_the_arms_own_code(cold: Stepper) -> None:
    """Loops over lanes, unrolled and vectorized, were nine tenths of a short arm's code.

    Each move of rows is compiled once, however often it is called.
    """
    (code,) = cold._program.advance.inspect_llvm().values()
    functions = re.findall(r"^define [^\n]*@([\w.]+)\((.*?)^\}", code, re.M | re.S)
    lines = {name: body.count("\n") for name, body in functions}
    moves = [name.partition(".")[0] for name in lines if "_double_double" in name]
    assert {"gathered_double_double", "scattered_double_double"} < set(moves)
    assert len(set(moves)) == len(moves)
    loops = [x for x in lines if re.match(r"gathered|scattered|(?!.*cpython).*advance", x)]
    assert sum(lines[x] for x in loops) < 0.5 * len(code.splitlines())


def test_a_step_allocates_nothing(cold: Stepper) -> None:
    """Neither in compiled code nor in Python."""
    (code,) = cold._program.advance.inspect_llvm().values()
    tracemalloc.start()
    cold.advance()
    tracemalloc.reset_peak()
    before, _ = tracemalloc.get_traced_memory()
    for _ in range(10):
        cold.advance()
    after, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert "define" in code
    assert not re.findall(r"call[^\n]*@(NRT_\w*[aA]lloc\w*|malloc)", code)
    assert after <= before + 64  # an integer or two
    assert peak - before < 1024


def text(arm: Arm, integrator: str = "rk4") -> str:
    """The generated module of an arm."""
    return Path(str(compile_arm(arm).program(LANES, integrator).__file__)).read_text()


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


OUT_OF_PLANE: dict[str, Callable[[Link], Link]] = {
    "EIy": lambda k: replace(k, EIy=17.0),
    "GJ": lambda k: replace(k, GJ=3.0),
    "rotary inertia": lambda k: replace(k, rho_Ip=0.3),
    "tip inertia": lambda k: replace(
        k, tip_inertia=((0.3, 0.01, 0.02), (0.01, 0.2, 0.03), (0.02, 0.03, 0.01))
    ),
}


@pytest.mark.parametrize("integrator", ["rk4", "midpoint"])
@pytest.mark.parametrize("n_link", [1, 2])
@pytest.mark.usefixtures("empty_cache")
def test_planar_code_knows_nothing_of_the_third_dimension(n_link: int, integrator: str) -> None:
    """Constants that only matter out of the plane do not occur: the text stays the same."""
    arm = planar(n_link, "planar")
    plain = body(text(arm, integrator))

    assert body(text(replace(arm, gravity=(0.0, -9.81, 3.0)), integrator)) == plain
    for name, change in OUT_OF_PLANE.items():
        changed = replace(arm, links=tuple(change(k) for k in arm.links))
        assert body(text(changed, integrator)) == plain, name
    heavier = replace(arm, links=tuple(replace(k, rho_A=2.1) for k in arm.links))
    assert body(text(heavier, integrator)) != plain


def body(module: str) -> str:
    """The accelerations of a generated module."""
    return module.split("accelerations = ")[1].split("measure = ")[0]


def operations(arm: Arm) -> dict[str, int]:
    return compile_arm(arm).operation_count()["accelerations"]


def test_lifting_a_planar_arm_costs_no_operation() -> None:
    """An offset along the joint axes moves no acceleration."""
    arm = planar(2, "planar")
    lift = replace(arm.links[0].joint, offset=(0.0, 0.0, 0.4))
    lifted = replace(arm, links=tuple(replace(k, joint=lift) for k in arm.links))

    assert operations(lifted) == operations(arm)


def test_turning_a_weightless_base_costs_no_operation() -> None:
    """Without gravity the first mounting rotation is invisible, however odd."""
    joint = random_arm(1, 1, 1).links[0].joint
    for n_link in (1, 2):
        arm = replace(planar(n_link, "planar"), gravity=(0.0, 0.0, 0.0))
        first = replace(arm.links[0], joint=Joint(rotation=joint.rotation, offset=joint.offset))
        turned = replace(arm, links=(first, *arm.links[1:]))

        assert operations(turned) == operations(arm)


def test_what_an_arm_lacks_costs_no_operation() -> None:
    """Each part costs something, so leaving it out saves it."""
    plain = planar(2, "planar")
    cost = sum(operations(plain).values())
    for change in ({"tip_mass": 0.0}, {"modes": ()}):
        poorer = replace(plain, links=tuple(replace(k, **change) for k in plain.links))
        assert sum(operations(poorer).values()) < cost, change
    assert sum(operations(replace(plain, gravity=(0.0, 0.0, 0.0))).values()) < cost
    for joint in (Joint(viscous=0.1), Joint(rotor_inertia=0.1), Joint(coulomb=0.1)):
        richer = replace(plain, links=tuple(replace(k, joint=joint) for k in plain.links))
        assert sum(operations(richer).values()) > cost, joint


# ---- cache ---------------------------------------------------------------------------------------


def imported_modules() -> set[str]:
    """Modules of the package that making and running a generated module imports."""
    code = (
        "import sys; from dynamics.backends.numba_llvm import program; "
        "print(*sorted(m for m in sys.modules if m.startswith('dynamics.')))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return set(result.stdout.split())


def test_the_key_covers_every_source_that_generates_code() -> None:
    """Whatever the generator imports is hashed, but for the cache itself and the presets."""
    hashed = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for path in keys.sources(keys.GENERATING)
    }
    unhashed = {"dynamics.cache", "dynamics.load", "dynamics.types"}
    missing = imported_modules() - hashed - unhashed
    assert {name for name in missing if not name.startswith("dynamics.arms")} == set()


def copied_hash(package: Path) -> str:
    return keys.hash_of_files(
        path for room in keys.GENERATING for path in (package / room).rglob("*.py")
    )


@pytest.mark.parametrize(
    "name",
    [
        "description/link", "formulations/gibbs_appell", "formulations/articulated_body",
        "formulations/kinematics", "integrators/newmark", "tracing/ssa",
        "backends/numba_llvm/vector_code", "backends/numba_llvm/stepper_entries", "runtime/jit",
    ],
)  # fmt: skip
def test_an_edited_source_cannot_run_stale(name: str, tmp_path: Path) -> None:
    """One more byte in the rooms that generate code is another key."""
    package = tmp_path / "dynamics"
    shutil.copytree(ROOT / "dynamics", package, ignore=shutil.ignore_patterns("__pycache__"))
    copied = copied_hash(package)
    source = package / f"{name}.py"
    source.write_bytes(source.read_bytes() + b"\n")

    assert copied == keys._SOURCES
    assert copied_hash(package) != copied


def test_an_edited_question_recompiles_nothing(tmp_path: Path) -> None:
    """Sources above the generated code are not in its key."""
    package = tmp_path / "dynamics"
    shutil.copytree(ROOT / "dynamics", package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("model", "simulation/case_file", "accuracy/scene", "arms/measures"):
        (package / f"{name}.py").write_text("", encoding="utf-8")
    assert copied_hash(package) == keys._SOURCES


def test_the_key_speaks_for_the_code_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files edited under a running process do not change its keys; other sources do."""
    here = fingerprint("an arm")
    monkeypatch.setattr(keys, "PACKAGE", Path("elsewhere"))
    assert fingerprint("an arm") == here
    monkeypatch.setattr(keys, "_SOURCES", "other sources")
    assert fingerprint("an arm") != here


@pytest.mark.usefixtures("empty_cache")
def test_programs_differ_in_all_that_determines_them() -> None:
    """Arm, lanes, method and free parameters; another description is another program."""
    arm = planar(1, "planar")
    model = compile_arm(arm)
    programs = [
        model.program(LANES, "rk4"),
        model.program(1, "rk4"),
        model.program(LANES, "midpoint"),
        compile_arm(arm, free_parameters=("stiffness",)).program(LANES, "rk4"),
        compile_arm(arm, free_parameters=("payload_mass",)).program(LANES, "rk4"),
        compile_arm(replace(arm, gravity=(0.0, -9.82, 0.0))).program(LANES, "rk4"),
        compile_arm(replace(arm, rotation="linear")).program(LANES, "rk4"),
    ]

    assert len({program.__file__ for program in programs}) == len(programs)
    assert compile_arm(arm).program(LANES, "rk4") is programs[0]


def test_a_source_is_written_whole_or_not_at_all(empty_cache: Path) -> None:
    """A build that fails leaves nothing behind."""

    def failing() -> str:
        raise RuntimeError("interrupted")

    with pytest.raises(RuntimeError, match="interrupted"):
        cached_module("broken", failing)

    assert not empty_cache.exists() or not list(empty_cache.iterdir())


def test_arms_loaded_from_the_cache_keep_their_own_code(empty_cache: Path) -> None:
    """Entry points have the arm's key in their linker names; all other functions are internal."""
    programs = [compile_arm(planar(1, name)).program(1, "rk4") for name in ("first", "second")]
    assert programs[0].__name__ != programs[1].__name__
    for module in programs:
        assert module.evaluate_often.py_func.__module__ == module.__name__
        module.evaluate_often.compile("void(float64[::1], int64)")
        (text,) = module.evaluate_often.inspect_llvm().values()
        assert re.search(r"define internal .*@accelerations\(", text)


def test_a_jacobian_too_long_to_compile_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """With what to take instead; one operation fewer is not."""
    arm = TracedArm(load_arm("slim"))
    count = graphs.state_jacobian(arm).n_instructions()
    inputs = [0, 10, 20, 30, 40]
    at = dict.fromkeys(("Q", "V", "ACC", "IMPLICIT", "SCRATCH", "TAU"), 50)
    monkeypatch.setattr(methods, "LONGEST", count)
    assert [f.name for f in traced_method("rosenbrock", arm, at, inputs).functions] == ["AID"]
    monkeypatch.setattr(methods, "LONGEST", count - 1)
    with pytest.raises(ValueError, match=f"takes {count} operations .* 'midpoint'"):
        traced_method("rosenbrock", arm, at, inputs)


def test_without_numbas_compiler_steps_are_refused_by_name_and_graphs_still_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model, rest = compile_arm("slim"), np.zeros(3)
    mass = model.mass_matrix(rest)
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)

    np.testing.assert_array_equal(model.mass_matrix(rest), mass)
    with pytest.raises(ValueError, match="unset the environment variable NUMBA_DISABLE_JIT"):
        model.accelerations(rest, rest, np.zeros(1))
    with pytest.raises(ValueError, match="unset the environment variable NUMBA_DISABLE_JIT"):
        Stepper(model, 2, dt=1e-4, substeps=1)
