"""A mechanism in CasADi, integrated by IDAS of SUNDIALS."""

import importlib
from typing import Any, final

import numpy as np

from ancfdae.numerics.arrays import Array
from validation.peers.formulas import Mechanism

# Relative to the tolerance: absolute tolerances, of coordinates of the size of one.
_ABSOLUTE = 1e-2


@final
class CasadiRuns:
    """Motion and gradient of a mechanism to a tolerance, as functions that stand."""

    def __init__(self, mechanism: Mechanism, tolerance: float) -> None:
        self._b = np.array(mechanism.b)
        ca: Any = importlib.import_module("casadi")
        n = len(mechanism.q_0)
        q, v, a = (ca.SX.sym(name, n) for name in "qva")
        b = ca.SX.sym("b", len(mechanism.b))
        of_q, of_v, of_b = (ca.vertsplit(x) for x in (q, v, b))
        M = ca.vertcat(*(ca.horzcat(*row) for row in mechanism.mass(ca, of_q, of_b)))
        Q = ca.vertcat(*mechanism.force(ca, of_q, of_v, of_b))
        Phi = ca.vertcat(*mechanism.closure(ca, of_q))
        observed = mechanism.observed(of_q, of_v)
        lam = ca.SX.sym("lam", Phi.numel())
        Phi_q = ca.jacobian(Phi, q)
        rate = ca.jtimes(Phi, q, v)
        gamma = ca.jtimes(rate, q, v)
        equations = {
            "x": ca.vertcat(q, v),
            "z": ca.vertcat(a, lam),
            "p": b,
            "ode": ca.vertcat(v, a),
            "alg": ca.vertcat(M @ a + Phi_q.T @ lam - Q, Phi_q @ a + gamma),
            "quad": observed,
        }
        options = {
            "reltol": tolerance,
            "abstol": _ABSOLUTE * tolerance,
            "quad_err_con": True,
            "fsens_err_con": True,
            "max_num_steps": 10**6,
        }
        run = ca.integrator("run", "idas", equations, 0.0, mechanism.t_end, options)
        start = np.concatenate([mechanism.q_0, np.zeros(n)])
        symbol = ca.MX.sym("b", len(self._b))
        # Consistent accelerations, which IDAS finds from any guess.
        end = run(x0=start, p=symbol, z0=self._guess(ca, equations, start))
        value = end["qf"] if mechanism.integral else self._observed(ca, observed, q, v, end, n)
        self._motion = ca.Function("motion", [symbol], [value])
        self._gradient = ca.Function("gradient", [symbol], [value, ca.jacobian(value, symbol)])

    def _guess(self, ca: Any, equations: dict[str, Any], start: Array) -> Array:
        """Solve the algebraic equations at the start, linear in accelerations and multipliers."""
        alg, z = equations["alg"], equations["z"]
        linear = ca.Function(
            "linear",
            [equations["x"], equations["p"]],
            [ca.jacobian(alg, z), ca.substitute(alg, z, 0 * z)],
        )
        matrix, right = (np.asarray(x) for x in linear(start, self._b))
        return -np.linalg.solve(matrix, right).ravel()

    def _observed(self, ca: Any, observed: Any, q: Any, v: Any, end: Any, n: int) -> Any:
        return ca.Function("observed", [q, v], [observed])(end["xf"][:n], end["xf"][n:])

    def motion(self) -> float:
        """Return the objective."""
        return float(self._motion(self._b))

    def gradient(self) -> Array:
        """Return the gradient of the objective."""
        return np.asarray(self._gradient(self._b)[1]).ravel()
