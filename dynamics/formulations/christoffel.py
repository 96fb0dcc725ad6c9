"""Velocity terms H(q, v) v with Christoffel's H, for which dM/dt - 2 H is skew-symmetric.

Yuan, Book & Huggins (1993), (A3) to (A5). Energy proofs of joint controllers need this property; of
all H with the same product H v only this one has it.
"""

from typing import Any

from dynamics.formulations.dense_solve import Equations
from dynamics.formulations.kinematics import Chain


def christoffel(equations: Equations, chain: Chain, n: int) -> Any:
    """CasADi Function (q, v) -> (n, n) H of a chain with n coordinates.

    H_jk = 1/2 sum_a (dM_jk/dq_a + dM_ja/dq_k - dM_ka/dq_j) v_a
         = 1/2 (dM/dt + N - N'),  N = d(M v)/dq at constant v
    """
    import casadi as ca

    q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
    rows = equations.mass_matrix(chain, ca.vertsplit(q))
    M = ca.vertcat(*(ca.horzcat(*row) for row in rows))
    N = ca.jacobian(M @ v, q)
    M_dot = ca.reshape(ca.jtimes(ca.vec(M), q, v), n, n)
    return ca.Function("christoffel", [q, v], [ca.densify(0.5 * (M_dot + N - N.T))])
