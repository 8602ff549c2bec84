"""A published problem, and its answer by a way that shares nothing with this package's methods.

A problem is written once as a reader of its source would: M, Q and Phi. By hand, and for the
reference alone, come Phi_q and the part of the second time derivative of Phi that accelerations do
not enter. With them the accelerations are those of

    [M  Phi_q^T] [a  ]   [Q     ]
    [Phi_q   0 ] [lam] = [-gamma],   d^2 Phi/dt^2 = Phi_q a + gamma,

which SciPy's DOP853 integrates; a complex step through the whole integration gives derivatives with
respect to design variables.
"""

from abc import abstractmethod
from typing import ClassVar, Self

import numpy as np
from scipy.integrate import solve_ivp

from ancfdae import Integral, Terminal
from ancfdae.extend import FormulaSystem
from ancfdae.numerics.arrays import Array
from ancfdae.observables import custom
from ancfdae.sensitivity.objectives import Objective

_STEP = 1e-40


class TestProblem(FormulaSystem):
    """A problem with a published answer; three design variables.

    `published` is the objective as the source prints it, right to the relative accuracy `digits`;
    it is the integral of the observable or, unless `integral`, its value at the end time. `step`
    is the largest step of HHT that is run; s. `stiff` problems leave out `DOP853`, which needs
    100,000 steps for a decay that does not matter. `values` are the design values of the source.
    """

    title: ClassVar[str]
    source: ClassVar[str]
    t_end: ClassVar[float]
    published: ClassVar[float]
    digits: ClassVar[float]
    integral: ClassVar[bool] = False
    step: ClassVar[float]
    stiff: ClassVar[bool] = False
    values: ClassVar[tuple[float, ...]]

    def __init__(self, b: Array | tuple[float, ...] | None = None) -> None:
        super().__init__(self.values if b is None else b)

    def with_values(self, b: Array) -> Self:
        """Return the problem at other values."""
        return type(self)(b)

    @abstractmethod
    def jacobian(self, t: float, q: Array) -> Array:
        """Return Phi_q, shape (n_lam, n_q), by hand."""

    @abstractmethod
    def gamma(self, t: float, q: Array, v: Array) -> Array:
        """Return d^2 Phi/dt^2 where accelerations vanish, by hand."""

    @abstractmethod
    def observed(self, q: Array, v: Array, b: Array) -> Array:
        """Return what the objective is made of; q and v have any leading shape."""

    def objective(self) -> Objective:
        """Return the objective."""
        kind = Integral if self.integral else Terminal
        return kind(custom(lambda t, q, v, lam, b: self.observed(q, v, b), "observed"))

    def reference(self, t_end: float, rtol: float) -> Array:
        """Return the objective and its gradient by SciPy, shape (4,)."""
        b, gradient = np.asarray(self.b, dtype=float), []
        for i in range(self.n_b):
            moved = self.with_values(b + 1j * _STEP * np.eye(self.n_b)[i])
            assert isinstance(moved, TestProblem)
            value = moved._end(t_end, rtol)
            gradient.append(value.imag / _STEP)
        return np.array([value.real, *gradient])

    def _end(self, t_end: float, rtol: float) -> complex:
        """Return the objective at complex values of the design variables."""
        q, v = self.start()
        scale = np.abs(np.concatenate([q, v])).max()

        def rate(t: float, y: Array) -> Array:
            q, v = y[: self.n_q], y[self.n_q : -1]
            return np.concatenate(
                [v, self.accelerations(t, q, v)[0], [self.observed(q, v, self.b)]]
            )

        start = np.concatenate([q, v, [0]]).astype(complex)
        tolerances = {"rtol": rtol, "atol": rtol * 1e-6 * scale}
        y = solve_ivp(rate, (0.0, t_end), start, "DOP853", **tolerances).y[:, -1]
        end = self.observed(y[: self.n_q], y[self.n_q : -1], self.b)
        return complex(y[-1] if self.integral else end)

    def accelerations(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return accelerations and multipliers."""
        G = self.jacobian(t, q)
        matrix = np.block([[self.mass_matrix(q), G.T], [G, np.zeros((self.n_lam, self.n_lam))]])
        known = np.concatenate([self.force(t, q, v), -self.gamma(t, q, v)])
        solved = np.linalg.solve(matrix, known)
        return solved[: self.n_q], solved[self.n_q :]
