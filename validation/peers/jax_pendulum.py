"""The paper's planar pendulum in JAX, in the plainest way: energy, HHT-I3, scan.

Forces and stiffness are automatic derivatives of the strain energy of an element, design
derivatives those of the loop over the steps. Nothing of the package is used.
"""

import importlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ancfdae.numerics.arrays import Array

_LENGTH, _WIDTH, _NU, _GRAVITY = 1.2, 0.05, 0.3, 9.81
# Newton's method stops at 1e-14 after these many iterations in all steps of the run.
_ITERATIONS = 3


def compiled(elements: int, step: float, steps: int, b: Array) -> list[Callable[[Array], Any]]:
    """Return the height of the free end after the steps, and its gradient by either mode.

    Functions of b = (E, height, density), compiled at the given values.
    """
    jax = _jax()
    height = _height(elements, step, steps)
    functions = [jax.jit(f) for f in (height, jax.jacfwd(height), jax.grad(height))]
    for function in functions:
        function(b).block_until_ready()
    return functions


def _jax() -> Any:
    jax: Any = importlib.import_module("jax")
    jax.config.update("jax_enable_x64", True)
    return jax


class _Beam(NamedTuple):
    """Mass matrix, weights and elastic forces of the beam as functions of b and q."""

    inertia: Callable[[Any], tuple[Any, Any]]
    elastic: Callable[[Any], tuple[Callable[[Any], Any], Callable[[Any], Any]]]


def _beam(jax: Any, elements: int) -> _Beam:
    """Return the planar 12-dof elements of a beam, integrated at 5 x 3 points each."""
    jnp: Any = jax.numpy
    length, where = _LENGTH / elements, _where(elements)
    x5, w5 = np.polynomial.legendre.leggauss(5)
    y3, w3 = np.polynomial.legendre.leggauss(3)

    def shapes(x: Any, y: Any) -> Any:
        s1, s3 = 1 - 3 * x**2 + 2 * x**3, 3 * x**2 - 2 * x**3
        s2, s4 = length * (x - 2 * x**2 + x**3), length * (x**3 - x**2)
        return jnp.stack([s1, s2, y * (1 - x), s3, s4, y * x])

    along = jax.vmap(jax.jacfwd(lambda z: shapes(z[0], z[1])))

    def points(height: Any) -> tuple[Any, Any]:
        x, y = jnp.meshgrid((x5 + 1) / 2, height * y3 / 2, indexing="ij")
        weights = jnp.outer(w5 * length / 2, w3 * height * _WIDTH / 2).ravel()
        return jnp.stack([x.ravel(), y.ravel()], 1), weights

    def energy(e: Any, modulus: Any, S: Any, weights: Any) -> Any:
        F = jnp.einsum("pki,kd->pdi", S, e.reshape(6, 2))
        E = (jnp.einsum("pdi,pdj->pij", F, F) - jnp.eye(2)) / 2
        lame, mu = modulus * _NU / (1 + _NU) / (1 - 2 * _NU), modulus / 2 / (1 + _NU)
        trace = jnp.trace(E, axis1=1, axis2=2)
        return weights @ (lame * trace**2 / 2 + mu * jnp.sum(E * E, (1, 2)))

    def inertia(b: Any) -> tuple[Any, Any]:
        n, (_, height, density) = 6 * (elements + 1), b
        at, weights = points(height)
        S = jax.vmap(lambda z: shapes(z[0], z[1]))(at)
        m = density * jnp.einsum("p,pi,pj->ij", weights, S, S)
        M = jnp.zeros((n, n)).at[where[:, :, None], where[:, None, :]].add(jnp.kron(m, jnp.eye(2)))
        weight = density * jnp.kron(weights @ S, jnp.array([0.0, -_GRAVITY]))
        return M, jnp.zeros(n).at[where].add(weight)

    def elastic(b: Any) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
        at, weights = points(b[1])
        constants = b[0], along(at) / jnp.array([length, 1.0]), weights
        gradient, hessian = (
            jax.vmap(lambda e, d=d: d(energy)(e, *constants)) for d in (jax.grad, jax.hessian)
        )
        return gradient, hessian

    return _Beam(inertia, elastic)


def _where(elements: int) -> Any:
    """Return the coordinates of each element."""
    return 6 * np.arange(elements)[:, None] + np.arange(12)


def _start(elements: int) -> Any:
    """Return the coordinates of the straight beam."""
    node = np.array([[0.0, 0], [1, 0], [0, 1]])
    places = _LENGTH / elements * np.arange(elements + 1)
    return np.concatenate([node + np.outer([1, 0, 0], [x, 0]) for x in places]).ravel()


def _height(elements: int, step: float, steps: int) -> Callable[[Array], Any]:
    """Return the height of the free end as a function of b."""
    jax = _jax()
    jnp: Any = jax.numpy
    n, alpha = 6 * (elements + 1), -0.3
    beta, gamma = (1 - alpha) ** 2 / 4, 0.5 - alpha
    beam, where, fixed = _beam(jax, elements), _where(elements), np.eye(2, n)

    def run(b: Any) -> Any:
        M, weight = beam.inertia(b)
        gradient, hessian = beam.elastic(b)

        def force(q: Any) -> Any:
            return weight - jnp.zeros(n).at[where].add(gradient(q[where]))

        def newton(known: Any, state: Any) -> Any:
            (a, lam), (q_p, rest) = state, known
            q = q_p + beta * step**2 * a
            K = jnp.zeros((n, n)).at[where[:, :, None], where[:, None, :]].add(hessian(q[where]))
            R = M @ a / (1 + alpha) + fixed.T @ lam - force(q) - alpha / (1 + alpha) * rest
            top = [M / (1 + alpha) + beta * step**2 * K, fixed.T]
            J = jnp.block([top, [fixed, jnp.zeros((2, 2))]])
            x = jnp.linalg.solve(J, jnp.concatenate([R, fixed @ q / (beta * step**2)]))
            return a - x[:n], lam - x[n:]

        def take(state: Any, _: Any) -> Any:
            q, v, a, lam, rest = state
            q_p = q + step * v + step**2 * (0.5 - beta) * a
            guess = a, lam
            for _ in range(_ITERATIONS):
                guess = newton((q_p, rest), guess)
            new, lam = guess
            q = q_p + beta * step**2 * new
            v = v + step * ((1 - gamma) * a + gamma * new)
            return (q, v, new, lam, fixed.T @ lam - force(q)), None

        q = jnp.asarray(_start(elements))
        J = jnp.block([[M, fixed.T], [fixed, jnp.zeros((2, 2))]])
        x = jnp.linalg.solve(J, jnp.concatenate([force(q), jnp.zeros(2)]))
        first = q, jnp.zeros(n), x[:n], x[n:], fixed.T @ x[n:] - force(q)
        (q, *_), _ = jax.lax.scan(take, first, None, length=steps)
        return q[n - 5]

    return run
