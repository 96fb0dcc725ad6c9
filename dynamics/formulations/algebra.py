"""Algebra of 3-vectors and 3x3 matrices as tuples of any scalar type: floats or CasADi symbols.

A Python `0.0` is a structural zero: it is never multiplied or added, so terms that an arm lacks
disappear while its recursion is traced.
"""

import math
from collections.abc import Sequence
from typing import Any

Scalar = Any  # float | casadi.SX
Vector = Sequence[Scalar]  # (3,)
Matrix = Sequence[Sequence[Scalar]]  # (3, 3)

ZERO: Vector = (0.0, 0.0, 0.0)
ZEROS: Matrix = (ZERO, ZERO, ZERO)
EYE: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def is_zero(x: Scalar) -> bool:
    """True if `x` is a structural zero."""
    return isinstance(x, float) and x == 0.0


def mul(a: Scalar, b: Scalar) -> Scalar:
    """Product."""
    if is_zero(a) or is_zero(b):
        return 0.0
    if isinstance(a, float) and abs(a) == 1.0:
        return b if a > 0.0 else -b
    if isinstance(b, float) and abs(b) == 1.0:
        return a if b > 0.0 else -a
    return a * b


def plus(*terms: Scalar) -> Scalar:
    """Sum."""
    total: Scalar = 0.0
    for x in terms:
        if not is_zero(x):
            total = x if is_zero(total) else total + x
    return total


def minus(a: Scalar, b: Scalar) -> Scalar:
    """Difference."""
    if is_zero(b):
        return a
    return -b if is_zero(a) else a - b


def sin(x: Scalar) -> Scalar:
    """Sine."""
    return math.sin(x) if isinstance(x, float) else x.sin()


def cos(x: Scalar) -> Scalar:
    """Cosine."""
    return math.cos(x) if isinstance(x, float) else x.cos()


def tanh(x: Scalar) -> Scalar:
    """Hyperbolic tangent."""
    return math.tanh(x) if isinstance(x, float) else x.tanh()


def sqrt(x: Scalar) -> Scalar:
    """Square root."""
    return math.sqrt(x) if isinstance(x, float) else x.sqrt()


def add(*vectors: Vector) -> Vector:
    """Sum of vectors."""
    return tuple(plus(*xs) for xs in zip(*vectors, strict=True))


def sub(a: Vector, b: Vector) -> Vector:
    """Difference of two vectors."""
    return tuple(minus(x, y) for x, y in zip(a, b, strict=True))


def scale(s: Scalar, a: Vector) -> Vector:
    """Multiple of a vector."""
    return tuple(mul(s, x) for x in a)


def dot(a: Sequence[Scalar], b: Sequence[Scalar]) -> Scalar:
    """Inner product."""
    return plus(*(mul(x, y) for x, y in zip(a, b, strict=True)))


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product a x b."""
    return (
        minus(mul(a[1], b[2]), mul(a[2], b[1])),
        minus(mul(a[2], b[0]), mul(a[0], b[2])),
        minus(mul(a[0], b[1]), mul(a[1], b[0])),
    )


def combine(coefficients: Sequence[Scalar], vectors: Sequence[Vector]) -> Vector:
    """Sum of coefficient times vector."""
    return add(ZERO, *(scale(s, a) for s, a in zip(coefficients, vectors, strict=True)))


def matvec(A: Matrix, x: Vector) -> Vector:
    """A x."""
    return tuple(dot(row, x) for row in A)


def transpose(A: Matrix) -> Matrix:
    """Transpose of a matrix."""
    return tuple(zip(*A, strict=True))


def tmatvec(A: Matrix, x: Vector) -> Vector:
    """A' x."""
    return matvec(transpose(A), x)


def madd(*matrices: Matrix) -> Matrix:
    """Sum of matrices."""
    return tuple(add(*rows) for rows in zip(*matrices, strict=True))


def msub(A: Matrix, B: Matrix) -> Matrix:
    """Difference of two matrices."""
    return tuple(sub(a, b) for a, b in zip(A, B, strict=True))


def mscale(s: Scalar, A: Matrix) -> Matrix:
    """Multiple of a matrix."""
    return tuple(scale(s, row) for row in A)


def mcombine(coefficients: Sequence[Scalar], matrices: Sequence[Matrix]) -> Matrix:
    """Sum of coefficient times matrix."""
    return madd(ZEROS, *(mscale(s, A) for s, A in zip(coefficients, matrices, strict=True)))


def matmul(A: Matrix, B: Matrix) -> Matrix:
    """A B."""
    columns = transpose(B)
    return tuple(tuple(dot(row, column) for column in columns) for row in A)


def symmetric(entry: Any) -> Matrix:
    """Symmetric matrix from `entry(i, j)`, called for i <= j only."""
    upper = {(i, j): entry(i, j) for i in range(3) for j in range(i, 3)}
    return tuple(tuple(upper[min(i, j), max(i, j)] for j in range(3)) for i in range(3))


def skew(a: Vector) -> Matrix:
    """a~, with a~ x = a x x."""
    return (
        (0.0, minus(0.0, a[2]), a[1]),
        (a[2], 0.0, minus(0.0, a[0])),
        (minus(0.0, a[1]), a[0], 0.0),
    )


def congruence(R: Matrix, A: Matrix, rotation: bool = True) -> Matrix:
    """R A R' of a symmetric A; for a true rotation R, a constant multiple of unity is A itself."""
    constant = all(isinstance(x, float) for row in A for x in row)
    if rotation and constant and mscale(A[0][0], EYE) == A:
        return A
    RA = matmul(R, A)
    return symmetric(lambda i, j: dot(RA[i], R[j]))


def rotate(R: Matrix, A: Matrix) -> Matrix:
    """R A R' of any A."""
    return matmul(matmul(R, A), transpose(R))
