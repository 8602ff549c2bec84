"""Small motions about a static configuration, which has design derivatives.

    M x'' + D x' + K x + Phi_q^T mu = 0,     Phi_q x = 0,
    K = -Q_q + (Phi_q^T lam)_q,     D = -Q_v     at v = 0

Motions x e^{st} make two pencils F(z) x + Phi_q^T mu = 0, Phi_q x = 0:

    without damping   F(z) = K - z M,              z = -s^2
    damped            F(z) = z^2 M + z D + K,      z = s
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem, Solution, reaction
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.errors.checks import require_array
from ancfdae.errors.kinds import InvalidInputError, SingularMatrix
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.statics.balance import Balance
from ancfdae.statics.controlled import idle_of


@final
@dataclass(frozen=True)
class LinearisationPoint:
    """Coordinates and multipliers of a static configuration.

    Attributes
    ----------
    q : array, shape (n_q,)
        Coordinates; m, slopes dimensionless.
    lam : array, shape (n_lam,)
        Multipliers, whose reactions pre-stress the joints; in N for constraints in m.
    q_b, lam_b : array, shape (n_q, n_b) and (n_lam, n_b), or None
        Design derivatives of q and lam; None if q and lam do not depend on the design.
    t : float
        Time at which prescribed motions are evaluated; s.
    v : array, shape (n_q,), or None
        Velocities of this configuration, which must be small except for states of controllers; None
        for zero velocity.
    v_b : array, shape (n_q, n_b), or None
        Design derivatives of v, used where velocities are states; None if states do not depend on
        the design.
    """

    q: Array
    lam: Array
    q_b: Array | None = None
    lam_b: Array | None = None
    t: float = 0.0
    v: Array | None = None
    v_b: Array | None = None

    def __repr__(self) -> str:
        sizes = f"{len(self.q)} coordinates, {len(self.lam)} multipliers"
        return f"LinearisationPoint: {sizes}, t = {self.t:.6g}"

    @staticmethod
    def of(solution: Solution, instant: int = -1) -> LinearisationPoint:
        """Return the configuration at one time of a solution, with its derivatives if it has them.

        Parameters
        ----------
        solution : Solution
        instant : int
            Index of the time; the last by default.

        Raises
        ------
        InvalidInputError
            If the solution has fewer than `instant` + 1 states.
        """
        count = len(solution.t)
        if not -count <= instant < count:
            raise InvalidInputError(
                "instant", f"must lie in 0 to {count - 1}", instant, "-1 is the last."
            )
        sensitivities = solution.sensitivities
        return LinearisationPoint(
            solution.q[instant],
            solution.lam[instant],
            None if sensitivities is None else sensitivities.q_b[instant],
            None if sensitivities is None else sensitivities.lam_b[instant],
            float(solution.t[instant]),
            solution.v[instant],
            None if sensitivities is None else sensitivities.v_b[instant],
        )

    def check(self, system: MechanicalSystem) -> None:
        """Raise InvalidInputError unless arrays have the shapes of a system and finite values."""
        require_array("LinearisationPoint.q", self.q, (system.n_q,))
        require_array("LinearisationPoint.lam", self.lam, (system.n_lam,))
        if self.q_b is not None:
            require_array("LinearisationPoint.q_b", self.q_b, (system.n_q, system.n_b))
        if self.lam_b is not None:
            require_array("LinearisationPoint.lam_b", self.lam_b, (system.n_lam, system.n_b))
        if self.v is not None:
            require_array("LinearisationPoint.v", self.v, (system.n_q,))
        if self.v_b is not None:
            require_array("LinearisationPoint.v_b", self.v_b, (system.n_q, system.n_b))


EPS = float(np.finfo(float).eps)
# Number of operations in an entry of K and a product with it, with a margin: a value below this
# many units of round-off of its terms counts as zero.
ROUND_OFF = 64
# Factors by which the change of a singular F(z) is raised until F(z) can be factorised.
_RAISED = (1.0, 1e3, 1e6)


@final
@dataclass(frozen=True)
class Linearised:
    """Matrices of small motions as values on the system's patterns; D is None without damping.

    M, D and K have shape (nnz,). q_b, (n_q, n_b), and lam_b, (n_lam, n_b), are the design
    derivatives of the configuration `at`.
    """

    system: MechanicalSystem
    at: LinearisationPoint
    q_b: Array
    lam_b: Array
    M: Array
    D: Array | None
    K: Array
    Phi_q: Array
    saddle: SaddlePoint
    mass: Factorization | None = None

    @staticmethod
    def of(
        system: MechanicalSystem,
        at: LinearisationPoint,
        damped: bool | None,
        saddle: SaddlePoint | None = None,
        mass: Factorization | None = None,
    ) -> Linearised:
        """Return a system linearised about a configuration; by default with any damping.

        `mass` is the factorised mass matrix with the constraints at `at`, if known. `saddle` is
        built if not given; RedundantConstraintsError if Phi_q has dependent rows.

        InvalidInputError if the configuration does not fit the system or a matrix is not finite.
        """
        at.check(system)
        _refuse_motion(system, at)
        rest = np.zeros((1, system.n_q))
        states = at.q[None], rest, rest, at.lam[None]
        # Infinite values are rejected below, without a warning.
        with np.errstate(all="ignore"):
            linearisation = system.linearise(np.array([at.t]), *states)
        D = None if linearisation.f_v is None or damped is False else linearisation.f_v[0]
        # A D that vanishes at this design may have design derivatives.
        if D is not None and not np.any(D) and not damped and not system.n_b:
            D = None
        matrices = (linearisation.M[0], linearisation.f_q[0], linearisation.Phi_q[0])
        if not all(np.all(np.isfinite(x)) for x in matrices):
            raise InvalidInputError(
                "configuration",
                "must have finite mass, stiffness and constraints",
                "NaN or infinity",
                "Check the configuration and the forces.",
            )
        q_b = np.zeros((system.n_q, system.n_b)) if at.q_b is None else at.q_b
        lam_b = np.zeros((system.n_lam, system.n_b)) if at.lam_b is None else at.lam_b
        saddle = saddle or saddle_point(system, at.t, at.q)
        return Linearised(system, at, q_b, lam_b, matrices[0], D, *matrices[1:], saddle, mass)

    def words(self, scene: str, other: str) -> str:
        """Return the text `scene` for a scene, or `other` for a user's system without elements."""
        return other if self.system.naming is None else scene

    @property
    def n_free(self) -> int:
        """Number of independent motions, n_q - n_lam."""
        return self.system.n_q - self.system.n_lam

    @property
    def n_modes(self) -> int:
        """Largest number of modes: `n_free`, or twice as many with damping."""
        return self.n_free if self.D is None else 2 * self.n_free

    @cached_property
    def idle(self) -> Array:
        """Indices of coordinates whose rates are states, and no forces' arguments, shape (k,)."""
        return idle_of(self.system)

    @cached_property
    def symmetric(self) -> bool:
        """Whether K and D are symmetric to round-off, as where forces have potentials."""
        if self.D is None and self.system.traits.symmetric:
            return True
        return all(self.is_symmetric(x) for x in (self.K, self.D) if x is not None)

    def is_symmetric(self, values: Array, sign: float = 1.0) -> bool:
        """Whether a matrix is symmetric to round-off; with sign -1, skew-symmetric."""
        pattern, root = self.system.pattern, np.sqrt(self.system.weights)
        scaled = pattern.csr(values / (root[pattern.rows] * root[pattern.columns]))
        skew = abs(scaled - sign * scaled.T)
        return bool(skew.max() <= ROUND_OFF * EPS * abs(scaled).max())

    # -- the pencil ----------------------------------------------------------------------------

    def matrix(self, z: complex) -> Array:
        """Values of F(z) on the pattern, shape (nnz,)."""
        if self.D is None:
            return self.K - z * self.M
        return z * z * self.M + z * self.D + self.K

    def slope(self, z: complex) -> Array:
        """Values of F'(z) on the pattern, shape (nnz,)."""
        return -self.M if self.D is None else 2 * z * self.M + self.D

    def slope_times(self, z: complex, x: Array) -> Array:
        """Return F'(z) x for a vector x or columns."""
        return self.times(self.slope(z), x)

    def times(self, values: Array, x: Array) -> Array:
        """Return the product of M, D or K, given by its values, with a vector or columns."""
        return self.system.pattern.dot(values, x)

    def works(self, X: Array, on_K: float, on_D: float) -> Array:
        """Return X^T (a K + b D) X, (k, k), for real X from forces, without reactions.

        a and b are `on_K` and `on_D`. Strains cancel before they are multiplied by a stiffness:
        motions without strain leave the square of round-off, where products with matrices leave
        round-off.
        """
        q, t = self.at.q, self.at.t
        rates = [self.system.force(t, q + 1j * STEP * on_K * x, 1j * STEP * on_D * x) for x in X.T]
        return -X.T @ np.imag(np.stack(rates, axis=1)) / STEP

    def squares(self, X: Array) -> Array:
        """Return x^H M x of each column of X, shape (k,)."""
        squares: Array = np.real(np.einsum("ij,ij->j", np.conj(X), self.times(self.M, X)))
        return squares

    # -- solving -------------------------------------------------------------------------------

    @cached_property
    def mass_factors(self) -> Factorization:
        """Factors of the mass matrix with the constraints."""
        return self.mass or self.saddle.factor(self.M, self.Phi_q)

    def factor_beside(self, z: complex) -> tuple[Factorization, bool]:
        """Return the factors of F(z) for inverse iteration, and whether F(z) was singular.

        A singular F(z) is factorised as F(z) + dz F'(z), which has the same shape at z: F x = 0
        makes y = x / dz solve (F + dz F') y = F' x. The change is round-off of F; where damping is
        large that may be too small for a shape, and is raised.
        """
        F = self.matrix(z)
        try:
            return self.saddle.factor(F, self.Phi_q), False
        except SingularMatrix:
            slope, size = self.slope(z), max(self.size, self.largest(F))
            change = ROUND_OFF * EPS * size / self.largest(slope) * slope
        for times in _RAISED:
            try:
                return self.saddle.factor(F + times * change, self.Phi_q), True
            except SingularMatrix as error:
                singular = error
        raise singular

    @cached_property
    def size(self) -> float:
        """Largest entry of K in the norm of the weights; 1 if K is zero."""
        return self.largest(self.K) or 1.0

    def largest(self, values: Array) -> float:
        """Return the largest entry of a matrix in the norm of the weights."""
        pattern, root = self.system.pattern, np.sqrt(self.system.weights)
        return float(np.max(np.abs(values) / (root[pattern.rows] * root[pattern.columns])))

    def solve(self, factors: Factorization, force: Array) -> Array:
        """Return x of a saddle-point equation with Phi_q x = 0 for a force; vector or columns."""
        n, none = len(force), np.zeros((self.system.n_lam, *force.shape[1:]))
        return self.constrained(factors, factors.solve(np.concatenate([force, none]))[:n])

    def constrained(self, factors: Factorization, x: Array) -> Array:
        """Return the motions x without the constraint violation that round-off has left.

        Forces of stiff bodies have more round-off than constraints.
        """
        n = len(x)
        pattern, scale = self.system.constraint_pattern, self.saddle.scale[n:]
        left = pattern.dot(self.Phi_q, x)
        size = pattern.dot(np.abs(self.Phi_q), np.abs(x))
        violation, terms = (np.max(scale * np.abs(y).T, initial=0.0) for y in (left, size))
        if violation <= EPS * terms:
            return np.asarray(x)
        return np.asarray(x - factors.solve(np.concatenate([0 * x, left]))[:n])

    def multipliers(self, z: Array, X: Array) -> Array:
        """Return mu of F(z) x + Phi_q^T mu = 0 for modes, the columns of X; (n_lam, k)."""
        force = np.zeros(X.shape, dtype=np.result_type(X, z))
        for j, value in enumerate(z):
            force[:, j] = -self.times(self.matrix(value), X[:, j])
        none = np.zeros((self.system.n_lam, X.shape[1]))
        return np.asarray(self.mass_factors.solve(np.concatenate([force, none]))[len(force) :])

    # -- sizes of round-off --------------------------------------------------------------------

    def round_off(self, values: Array, X: Array) -> Array:
        """Return eps |x|^T |K| |x|, the round-off of x^T K x, for each column of X, (k,)."""
        size = np.abs(X)
        return np.asarray(EPS * np.einsum("ij,ij->j", size, self.times(np.abs(values), size)))

    @cached_property
    def unbalanced(self) -> float:
        """Norm of the force Q - Phi_q^T lam over that of its terms; zero in an equilibrium."""
        system, at = self.system, self.at
        Q = system.force(at.t, at.q, np.zeros(system.n_q))
        held = reaction(system, at.t, at.q, at.lam)
        inverse = 1 / system.weights
        left = norm(Q - held, inverse)
        if Balance(system, at.t, at.q, at.lam).is_round_off(Q - held, self.K, at.q, at.lam):
            return 0.0
        return left / (norm(Q, inverse) + norm(held, inverse))


# Largest centrifugal force, relative to all forces, of a state that counts as static.
_AT_REST = 1e-6


def _refuse_motion(system: MechanicalSystem, at: LinearisationPoint) -> None:
    """Reject a rotating state: its centrifugal force M v^2/|q| adds a stiffness."""
    if at.v is None:
        return
    v = np.array(at.v)
    v[system.state_places] = 0.0
    if not np.any(v):
        return
    inverse = 1 / system.weights
    still = np.zeros(system.n_q)
    forces = norm(system.force(at.t, at.q, still), inverse)
    forces += norm(reaction(system, at.t, at.q, at.lam), inverse)
    turning = norm(v, system.weights) ** 2 / (norm(at.q, system.weights) or 1.0)
    if turning > _AT_REST * forces:
        raise InvalidInputError(
            "modes, at",
            "must be a state at rest: centrifugal and Coriolis forces are not in these modes",
            f"an instant at t = {at.t:.6g} whose motion takes {turning / (forces or 1.0):.2g} of "
            "all forces",
            "Pass at=equilibrium(...), or an instant at which it has come to rest; for vibrations "
            "about a steady rotation declare the scene in a RotatingFrame.",
        )


def split(linear: Callable[[Array], Array], x: Array) -> Array:
    """Return the value of a function, linear over the real numbers, at a complex vector."""
    if x.dtype.kind != "c":
        return linear(x)
    return linear(x.real) + 1j * linear(x.imag)
