"""Jets, each a value with its first and second time derivative, and the shapes of links."""

import numpy as np

from dynamics import Link, Mode
from dynamics.description.mode_shapes import Shape, shape
from dynamics.types import Array

NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)  # round-off up to the third mode
X, Y, Z = np.eye(3)


def _product(A: Array, B: Array) -> Array:
    """Leibniz' rule for A B."""
    return np.stack(
        [A[0] @ B[0], A[1] @ B[0] + A[0] @ B[1], A[2] @ B[0] + 2.0 * A[1] @ B[1] + A[0] @ B[2]]
    )


def _rotation(theta: Array) -> Array:
    """exp(theta~) of vector jets (3, N, 3): a jet is a block triangular matrix, so expm holds."""
    T = np.zeros((theta.shape[1], 9, 9))
    for order, scale in ((0, 1.0), (1, 1.0), (2, 0.5)):
        block = scale * np.cross(theta[order][:, None, :], -np.eye(3))
        for k in range(3 - order):
            T[:, 3 * k : 3 * k + 3, 3 * (k + order) : 3 * (k + order) + 3] = block
    E = _exponential(T)
    return np.stack([E[:, :3, :3], E[:, :3, 3:6], 2.0 * E[:, :3, 6:]])


def _angles(slopes: Array) -> Array:
    """Rotation vectors (3, N, 3) of sections whose bending slopes are sines, twist along x."""
    bent = slopes * (Y + Z)

    def times(a: Array, b: Array) -> Array:
        return np.stack([a[0] * b[0], a[1] * b[0] + a[0] * b[1],
                         a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2]])  # fmt: skip

    x = times(bent, bent).sum(axis=-1, keepdims=True)
    return slopes + times(x / 6.0 + 3.0 / 40.0 * times(x, x), bent)  # of asin s = s + s^3/6 + ...


def _exponential(A: Array) -> Array:
    """exp(A) of many matrices: Taylor series of A / 16, squared four times."""
    result = term = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
    for k in range(1, 20):
        term = term @ A / (16.0 * k)
        result = result + term
    for _ in range(4):
        result = result @ result
    return result


def _vector(A: Array) -> Array:
    """(N, 3) of skew-symmetric (N, 3, 3)."""
    return np.stack([A[:, 2, 1], A[:, 0, 2], A[:, 1, 0]], axis=1)


def _constant(x: object) -> Array:
    """Jet of one constant vector or matrix."""
    value = np.array(x, dtype=np.float64)
    value = value[:, None] if value.ndim == 1 else value
    return np.stack([value, 0.0 * value, 0.0 * value])[:, None]


def _shapes(link: Link) -> list[tuple[Mode, Shape]]:
    return [(mode, shape(mode, link.beam)) for mode in link.modes]


def _deflection(link: Link, delta: Array, x: Array, shorten: bool) -> tuple[Array, Array]:
    """Jets of points (3, N, 3, 1) in the link's frame and of their sections' rotation (3, N, 3)."""
    r = np.zeros((3, x.size, 3))
    r[0] = np.outer(x, X)
    theta = np.zeros((3, x.size, 3))
    inside = 0.5 * np.outer(x, NODES + 1.0)  # (N, nodes) from the root to each point
    for (mode, s), d in zip(_shapes(link), delta.T, strict=True):
        if mode.direction == "x":
            theta += np.multiply.outer(d, np.outer(s.value(x), X))
            continue
        if mode.direction == "axial":
            r += np.multiply.outer(d, np.outer(s.value(x), X))
            continue
        along, about = (Y, Z) if mode.direction == "y" else (Z, -Y)
        r += np.multiply.outer(d, np.outer(s.value(x), along))
        theta += np.multiply.outer(d, np.outer(s.slope(x), about))
        for (other, p), e in zip(_shapes(link), delta.T, strict=True):
            if shorten and other.direction == mode.direction:
                common = 0.5 * x * ((s.slope(inside) * p.slope(inside)) @ WEIGHTS)
                both = np.array([d[0] * e[0], d[1] * e[0] + d[0] * e[1], 0.0])
                both[2] = d[2] * e[0] + 2.0 * d[1] * e[1] + d[0] * e[2]
                r -= 0.5 * np.multiply.outer(both, np.outer(common, X))
    return r[..., None], theta


def _bending_of_shortening(link: Link, delta: Array) -> Array:
    """(m,) gradient of 1/2 int (EIz y' y'' + EIy z' z'')(y' y'' + z' z''), by complex steps."""
    x, weights = 0.5 * link.length * (NODES + 1.0), 0.5 * link.length * WEIGHTS
    shapes = _shapes(link)

    def energy(amplitudes: Array) -> complex:
        rates = []
        for direction in "yz":
            own = [
                (d, s) for d, (m, s) in zip(amplitudes, shapes, strict=True)
                if m.direction == direction
            ]  # fmt: skip
            slope = sum((d * s.slope(x) for d, s in own), 0.0 * x)
            rates.append(slope * sum((d * s.curvature(x) for d, s in own), 0.0 * x))
        rigid = (link.EIz or 0.0) * rates[0] + (link.EIy or 0.0) * rates[1]
        return complex(0.5 * weights @ (rigid * (rates[0] + rates[1])))

    return np.array([energy(delta + 1e-30j * e).imag / 1e-30 for e in np.eye(len(delta))])
