"""Elementary functions as branch-free basic operations, accurate to the last bits of a float64."""

from collections.abc import Sequence

from dynamics.tracing.ssa import Code

# Chebyshev interpolants in r^2 on |r| <= pi/2, error below 5e-18: sin(r)/r and cos(r)
_SIN = (
    1.0, -0.16666666666666666, 0.008333333333333188, -0.00019841269841209248,
    2.7557319211371395e-06, -2.5052106906928565e-08, 1.6058941846319291e-10,
    -7.643055069294625e-13, 2.7219061281368675e-15,
)  # fmt: skip
_COS = (
    1.0, -0.4999999999999997, 0.04166666666666388, -0.00138888888887731, 2.4801587277434662e-05,
    -2.755731639270276e-07, 2.087656191423543e-09, -1.1462903556350365e-11, 4.6089915978490734e-14,
)  # fmt: skip
_PI = (3.1415926534682512, 1.2154201012607932e-10, 4.044532497591901e-21)  # pi in three parts
_TANH_SATURATES = 20.0  # tanh(20) = 1 - 8e-18


def polynomial(code: Code, coefficients: Sequence[float], x: int) -> int:
    """Polynomial in x by Horner's rule; `coefficients` start with the constant."""
    value = code.constant(coefficients[-1])
    for c in reversed(coefficients[:-1]):
        value = code.emit("+", code.emit("*", value, x), code.constant(c))
    return value


def sqrt(code: Code, x: int) -> int:
    """Square root; the root of a square becomes an absolute value."""
    op, args = code.statements[x]
    if op == "*" and args[0] == args[1]:
        return code.emit("abs", args[0])
    return code.emit("sqrt", x)


def sin(code: Code, x: int) -> int:
    """Branch-free sine."""
    sign, r = _reduced(code, x)
    r_signed = code.emit("*", sign, r)
    return code.emit("*", r_signed, polynomial(code, _SIN, code.emit("*", r, r)))


def cos(code: Code, x: int) -> int:
    """Branch-free cosine."""
    sign, r = _reduced(code, x)
    return code.emit("*", sign, polynomial(code, _COS, code.emit("*", r, r)))


def _reduced(code: Code, x: int) -> tuple[int, int]:
    """Reduction x = k pi + r: returns the sign (-1)^k and r.

    Accurate to 2e-16 for |x| < 1e4 and to 1e-12 for |x| < 1e8.
    """
    emit, constant = code.emit, code.constant
    turns = emit("*", x, constant(0.3183098861837907))
    k = emit("floor", emit("+", turns, constant(0.5)))
    r = x
    for part in _PI:
        r = emit("-", r, emit("*", k, constant(part)))
    even = emit("*", constant(2.0), emit("floor", emit("*", constant(0.5), k)))
    sign = emit("-", constant(1.0), emit("*", constant(2.0), emit("-", k, even)))
    return sign, r


def tanh(code: Code, x: int) -> int:
    """Branch-free tanh = m / (m + 2), m = expm1(2 x) by a series and ten doublings."""
    emit, constant = code.emit, code.constant
    limit = constant(_TANH_SATURATES)
    x = emit("max", emit("min", x, limit), constant(-_TANH_SATURATES))
    z = emit("*", x, constant(2.0 / 1024.0))
    coefficients, c = [], 1.0
    for k in range(1, 10):
        c /= k
        coefficients.append(c)
    m = emit("*", z, polynomial(code, coefficients, z))
    for _ in range(10):
        m = emit("*", m, emit("+", m, constant(2.0)))
    return emit("/", m, emit("+", m, constant(2.0)))
