"""A mechanism in JAX, integrated by diffrax."""

import importlib
from functools import cache
from typing import Any, final

import numpy as np

from ancfdae.numerics.arrays import Array
from validation.peers.formulas import Mechanism

_ABSOLUTE = 1e-2
_MOST_STEPS = 16_384


@final
class DiffraxRuns:
    """Motion and gradient of a mechanism to a tolerance, compiled once for all tolerances.

    Accelerations follow from a dense solve of the equations of index 1; the method is Dormand and
    Prince's of order 8 (`Dopri8`), derivatives go forward with the motion.
    """

    def __init__(self, mechanism: Mechanism, tolerance: float) -> None:
        self._b, self._tolerance = np.array(mechanism.b), tolerance
        self._motion, self._gradient = _compiled(mechanism)

    def motion(self) -> float:
        """Return the objective."""
        return float(self._motion(self._b, self._tolerance))

    def gradient(self) -> Array:
        """Return the gradient of the objective."""
        return np.asarray(self._gradient(self._b, self._tolerance))


@cache
def _compiled(mechanism: Mechanism) -> tuple[Any, Any]:
    """Return the compiled objective and its gradient, functions of b and the tolerance."""
    jax: Any = importlib.import_module("jax")
    jax.config.update("jax_enable_x64", True)
    objective = _objective(jax, importlib.import_module("diffrax"), mechanism)
    functions = jax.jit(objective), jax.jit(jax.jacfwd(objective))
    for function in functions:
        function(np.array(mechanism.b), 1e-3).block_until_ready()
    return functions


def _objective(jax: Any, diffrax: Any, mechanism: Mechanism) -> Any:
    """Return the objective as a function of b and the relative tolerance."""
    jnp, n, observed = jax.numpy, len(mechanism.q_0), mechanism.observed
    start = jnp.array([*mechanism.q_0, *np.zeros(n + 1)])

    def closure(q: Any) -> Any:
        return jnp.stack(mechanism.closure(jnp, q))

    def rates(t: Any, y: Any, b: Any) -> Any:
        q, v = y[:n], y[n : 2 * n]
        M = jnp.array(mechanism.mass(jnp, q, b))
        Q = jnp.stack(mechanism.force(jnp, q, v, b))
        Phi_q = jax.jacfwd(closure)(q)
        gamma = jax.jvp(lambda x: jax.jvp(closure, (x,), (v,))[1], (q,), (v,))[1]
        m = len(gamma)
        matrix = jnp.block([[M, Phi_q.T], [Phi_q, jnp.zeros((m, m))]])
        a = jnp.linalg.solve(matrix, jnp.concatenate([Q, -gamma]))[:n]
        return jnp.concatenate([v, a, jnp.reshape(observed(q, v), 1)])

    def objective(b: Any, tolerance: Any) -> Any:
        end = diffrax.diffeqsolve(
            diffrax.ODETerm(rates),
            diffrax.Dopri8(),
            0.0,
            mechanism.t_end,
            None,
            start,
            b,
            stepsize_controller=diffrax.PIDController(tolerance, _ABSOLUTE * tolerance),
            adjoint=diffrax.ForwardMode(),
            max_steps=_MOST_STEPS,
        ).ys[-1]
        return end[-1] if mechanism.integral else observed(end[:n], end[n : 2 * n])

    return objective
