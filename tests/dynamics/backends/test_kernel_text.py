"""CUDA C of programs: readable, in the number type asked for, refused where it cannot be."""

import ctypes

import pytest

from dynamics.backends.cuda.function_text import function_text
from dynamics.backends.cuda.kernel_text import PULL_BACK, RECORD, STEP, kernel_text
from dynamics.backends.cuda.program import generate
from dynamics.backends.cuda.statement_text import lines_of
from dynamics.backends.numba_llvm.program import stepping
from dynamics.load import load_arm
from dynamics.tracing.assembly import Addition, assembled
from dynamics.tracing.function import Function, written
from dynamics.tracing.ssa import Code
from dynamics.tracing.statements import (
    Call,
    ControlStep,
    Derivatives,
    Load,
    Pop,
    Push,
    Rows,
    Store,
    Substeps,
    Uniform,
    WhereEnded,
)
from dynamics.tracing.traced_arm import TracedArm
from tests.host_kernels import COMPILER, HostKernels

STATE = Rows("STATE", "state", 0, 6)


def polynomial() -> Function:
    """Slot 1 becomes max(w0 * w0 - 0.1, -2)."""
    code = Code()
    x = code.load(0)
    value = code.emit("-", code.emit("*", x, x), code.constant(0.1))
    return written("f", code, {1: code.emit("max", value, code.constant(-2.0))})


def swinging() -> Addition:
    """A control step that only moves the arm."""
    step = (Load("Q", STATE), Call("start"), Substeps((Call("step"),)), Store("Q", STATE))
    ended = WhereEnded("FLAGS", (Uniform("FLAGS", 2),))
    entry = ControlStep(step=(*step, ended), start=())
    return Addition(key="moved", sizes={"FLAGS": 2}, functions=lambda at: [], entry=entry)


def test_statements_become_constants_with_literals_of_the_type() -> None:
    single, double = (function_text(polynomial(), dtype) for dtype in ("float32", "float64"))
    assert "const real x3 = x1 - 0.1f;" in single
    assert "greatest(x3, (-2.0f));" in single
    assert "const real x3 = x1 - 0.1;" in double
    assert "w[1] = x5;" in double


def test_long_functions_are_called(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "__forceinline__ void f(real* w)" in function_text(polynomial(), "float32")
    monkeypatch.setattr("dynamics.backends.cuda.function_text.LONG", 3)
    assert "__noinline__ void f(real* w)" in function_text(polynomial(), "float32")


def test_a_program_prints_its_kernels() -> None:
    source = generate(TracedArm(load_arm("slim")), "float32", "rk4", swinging())
    text = source.text
    assert "typedef float real;" in text
    assert 'extern "C" __global__ void control_step(' in text
    assert "for (int s = 0; s < substeps; ++s) {" in text
    assert "if (w[FLAGS] != 0 || w[FLAGS + 1] != 0) {" in text
    assert text.count("{") == text.count("}")
    restart, step = text.partition("void restart(")[2].split("void control_step(")
    assert "uniform(streams + i)" in restart
    assert "uniform(" not in step
    assert text.isascii()


def test_derivatives_are_kernels_with_a_stack() -> None:
    """Pulling back begins on top of what recording has pushed; both print only what they call."""
    arm = TracedArm(load_arm("slim"))
    source = generate(arm, "float32", "rk4", swinging(), (RECORD, PULL_BACK))
    entry = source.program.entry
    assert isinstance(entry, Derivatives)
    assert f"STACK_FIXED = {entry.fixed}," in source.text
    record, back = source.text.partition("void record(")[2].split("void pull_back(")
    assert "int top = 0;" in record
    assert "int top = STACK_FIXED + STACK_PER_SUBSTEP * substeps;" in back
    assert "accelerations(w);" in record
    assert "IMBALANCE_adjoint(w);" in back
    assert "_tangent" not in source.text


def test_rows_of_actions_and_a_stack_of_columns() -> None:
    """A thread's top of the stack moves after a push and before a pop."""
    actions = Rows("GIVEN", "actions_mirror", 0, 2)
    statements = (Push("Q", 1, 3), Pop("Q", 0, 2), Store("TAU", actions))
    lines = [line for line in lines_of(statements, {}) if not line.startswith("#")]
    assert lines == [
        "for (int k = 0; k < 3; ++k) stack[(long long)(top + k) * count + i] = w[Q + 1 + k];",
        "top += 3;",
        "top -= 2;",
        "for (int k = 0; k < 2; ++k) w[Q + 0 + k] = stack[(long long)(top + k) * count + i];",
        "for (int k = 0; k < N_GIVEN; ++k) "
        "actions_mirror[(long long)i * N_GIVEN + k] = w[TAU + k];",
    ]


def test_numbers_hold_the_step_and_the_factors_of_the_method() -> None:
    arm = TracedArm(load_arm("slim"))
    plain = generate(arm, "float64", "rk4", swinging())
    assert plain.numbers(0.01, {}).tolist() == [0.01]
    prepared = generate(arm, "float64", "exponential-2", swinging())
    assert (prepared.numbers(0.01, {}) != 0.0).sum() > 20
    assert prepared.program.shared == ["H", "SCRATCH"]


def test_what_has_no_kernel_is_refused_with_the_remedy() -> None:
    arm = TracedArm(load_arm("slim"))
    with pytest.raises(ValueError, match="take 'midpoint'"):
        generate(arm, "float32", "rosenbrock", swinging())
    with pytest.raises(ValueError, match="add --env ID"):
        kernel_text(assembled(arm, "float32", 1, "rk4", stepping(arm)), "float32", (STEP,))


@pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")
def test_uniform_numbers_are_those_of_the_streams() -> None:
    """The flags' slots are nonzero once drawn, and the stream moves by the constant of splitmix."""
    source = generate(TracedArm(load_arm("slim")), "float64", "rk4", swinging())
    assert "uniform(streams + i)" in source.text
    kernels = HostKernels(source.text)
    state, stream = (ctypes.c_double * 6)(), ctypes.c_uint64(5)
    given = [ctypes.addressof(x) for x in (state, stream)] + [0] * 5 + [source.numbers(0.01, {})]
    kernels.launch("control_step", 0, 1, [*given, 1, 3])
    assert stream.value == 5  # no episode has ended
    assert list(state) == [0.0] * 6  # an arm at rest stays there
