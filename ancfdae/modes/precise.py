"""Lowest modes of thin bodies, which round-off of the matrix K hides.

An entry of K is a sum of axial and shear stiffness; the bending stiffness that remains of it is
(h/L)^2 times that, with n elements 1/n^2 of this: x^T K x has a round-off of eps |x|^T |K| |x|, as
large as z itself at h/L = 1e-6. Computed element by element, K x is the force of strains, in which
rigid rotation cancels before it is multiplied by a stiffness: accurate to eps (l/h)^2, l the length
of an element, which for 8 elements is 4,096 times less. Coordinates, too, are rounded: nodes with
an error of eps |q| have an axial force of eps EA. Where forces are in equilibrium to round-off, the
Newton correction below the last digit of q removes this force (as in `statics.equilibrium`).

The modes come from inverse iteration on a block: these products give its residual, the factorised
matrix turns the residual into a correction, and Ritz's method gives the values. Their round-off is
estimated by rounding coordinates and shapes differently.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias, final

import numpy as np
import scipy

from ancfdae.equations import reaction
from ancfdae.equations.saddle_points import held_q, solve
from ancfdae.errors.kinds import AncfdaeError, SingularMatrix
from ancfdae.modes.eigenpairs import distinct
from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.linear_solvers import Factorization
from ancfdae.statics.balance import Balance

# Relative round-off of z, twice that of a frequency, above which products with the matrix are not
# accurate enough, and above which modes are rejected. The bound compared with it is 50 times
# larger.
ALLOWED = 2e-6
# Number of additional vectors, with which a sweep gains a digit or more in a beam; and sweeps.
_GUARDS, _SWEEPS = 8, 60
# Sweeps end where values change by less than this, relative to the value plus the round-off of
# products with the matrix.
_SETTLED = 1e-7
# Shift, and least entry of D relative to the largest (both as in `statics.softness`).
_SHIFT, _TRACE = 1e-14, 1e-8
# Shift below the axial stiffness, 1/n^2 of the diagonal, and above bending and rigid motions.
_STIFF = 1e-10
# Size of the first block in the search of rigid motions, multiplied by _MORE as long as all motions
# found are rigid; and number of sweeps.
_FIRST, _MORE, _CLEANED = 8, 4, 3
# Round-off is estimated as _MARGIN times the largest change when rounded differently _ROUNDINGS
# times.
_MARGIN, _ROUNDINGS = 4.0, 3
# Factor on a correction of q before differences are taken, as in `statics.equilibrium`.
_MAGNIFIED = 2.0**17

_TOO_THIN = (
    "modes that did not converge: the bodies are too thin for their numbers. Use fewer elements, "
    "or hold free motions by joints or soft springs."
)
_TOO_STIFF = (
    "modes that did not converge: stiffnesses of the system differ by more digits than numbers "
    "have. Constrain the stiffest motions, or hold free motions by constraints or soft springs."
)

# Values, shapes as columns, and round-off in the values.
Modes: TypeAlias = tuple[Array, Array, Array]


@final
class NoModes(AncfdaeError):
    """Modes did not converge, or round-off makes them too inaccurate."""


@final
@dataclass(frozen=True)
class Precise:
    """Products K X of the stiffness at coordinates q, computed element by element.

    `stiff` are the factors of K + shift |diag K| that give corrections of q.
    """

    small: Linearised
    q: Array
    stiff: Factorization

    @cached_property
    def _beyond(self) -> tuple[Array, Array]:
        """Corrections of q and lam below the last digit of q, by one step of Newton's method.

        They cancel, in an equilibrium, the residual forces; otherwise the forces of stresses due to
        rounding of a body free of stress, less their reactions. They are zero where bodies carry
        other stresses out of equilibrium: such stresses cannot be told from round-off.
        """
        system, at, none = self.small.system, self.small.at, np.zeros(self.small.system.n_lam)
        Q = system.force(at.t, self.q, 0 * self.q)
        R = Q - reaction(system, at.t, self.q, at.lam)
        balance = Balance(system, at.t, self.q, at.lam)
        if not balance.is_round_off(R, self.small.K, self.q, at.lam):
            R = system.stress_force(self.q)
            blur = self.small.times(np.abs(self.small.K), np.abs(self.q))
            if not np.all(np.abs(R) <= ROUND_OFF * EPS * blur):
                return 0 * self.q, none
            # The reactions in the multipliers of the configuration that carry these forces.
            at_q = system.stress_force(at.q)
            R = R - reaction(system, at.t, self.q, solve(self.small.mass_factors, at_q, none)[1])
        return solve(self.stiff, R, none)

    def times(self, X: Array) -> Array:
        """Return K X for real columns X, (n_q, k)."""
        if not X.size:
            return X
        system, at = self.small.system, self.small.at
        dq, dlam = self._beyond
        step = _MAGNIFIED * dq
        product = self._elastic(self.q, X)
        if np.any(step):
            slope = self._elastic(self.q + step, X) - self._elastic(self.q - step, X)
            product = product + slope / (2 * _MAGNIFIED)
        held = held_q(system, at.t, self.q, 0 * self.q, at.lam + dlam)
        return product + system.pattern.dot(held, X)

    def _elastic(self, q: Array, X: Array) -> Array:
        system, still, t = self.small.system, np.zeros_like(self.q), self.small.at.t
        rates = [-np.imag(system.force(t, q + 1j * STEP * x, still)) for x in X.T]
        return np.stack(rates, axis=1) / STEP

    def left(self, X: Array, z: Array) -> Array:
        """Return the residuals M X z - K X of modes, (n_q, k)."""
        return self.small.times(self.small.M, X) * z - self.times(X)


def precise_modes(small: Linearised, X: Array) -> Modes:
    """Return the lowest modes of a symmetric pencil, as many as X has columns.

    Inverse iteration on a block from the guess X: x - P^-1 (K x - z M x) is z K^-1 M x where P is
    K. Beside rigid motions, which P makes the largest, other motions would be round-off: rigid
    motions are computed first, and the block is orthogonal to them.

    Raises
    ------
    NoModes
        If the modes do not converge.
    """
    count = X.shape[1]
    precise = Precise(small, small.at.q, _factors(small, _shifted(small, _STIFF)))
    factors = _factors(small, _shifted(small, _SHIFT))
    R = _rigid_motions(precise, factors)[:, :count]
    z, noise = np.zeros(R.shape[1]), _noise(precise, R, np.zeros(R.shape[1]))
    if R.shape[1] < count:
        others, X, round_off = _elastic_modes(precise, factors, R, X)
        z, noise, X = np.append(z, others), np.append(noise, round_off), np.hstack([R, X])
    else:
        X = R
    order = np.argsort(z, kind="stable")
    return z[order], X[:, order], noise[order]


def _rigid_motions(precise: Precise, factors: Factorization) -> Array:
    """Return all rigid motions, (n_q, k), orthonormal in M.

    `factors` are those of P = K + shift D, D = |diag K|. The block grows until it contains a motion
    stiffer than shift D: all softer motions, rigid or not, keep their size, and Ritz's method
    separates them only in a block that contains every one.

    x - P^-1 K x leaves rigid motions unchanged, and multiplies others by the ratio of shift D to P.
    In the norm of D a rotation about the axis of a thin body counts as much as a translation.

    Bending may be as soft as shift D. Its stiffness exceeds the round-off of products, and that of
    components eps of itself and of the stiffest shapes.
    """
    small, count, random = precise.small, _FIRST, np.random.default_rng(3)
    root = np.sqrt(_stiffness(small))[:, None]
    while True:
        count = min(count, small.n_free)
        X = small.solve(factors, root * random.standard_normal((len(root), count)))
        for _ in range(_CLEANED):
            X = X - small.solve(factors, precise.times(X))
        X = _basis(root * X) / root
        kappa, W = np.linalg.eigh(X.T @ precise.times(X))
        if np.all(kappa < _SHIFT) and count < small.n_free:
            count *= _MORE
            continue
        X = X @ W[:, kappa < _SHIFT]
        X = X / np.sqrt(_squares(small, X))
        z = np.einsum("ij,ij->j", X, precise.times(X))
        parts = small.round_off(small.K, X) + EPS * small.size
        noise = _noise(precise, X, z) + ROUND_OFF * EPS * parts
        R = X[:, np.abs(z) <= ROUND_OFF * noise]
        if R.shape[1] < count or count == small.n_free:
            return distinct(R, small.times(small.M, R))
        count *= _MORE


def _basis(X: Array) -> Array:
    """Return an orthonormal basis of the columns of X without components of round-off size."""
    U, sizes, _ = np.linalg.svd(X / np.linalg.norm(X, axis=0), full_matrices=False)
    return np.asarray(U[:, sizes > ROUND_OFF * EPS * sizes[0]])


def _elastic_modes(precise: Precise, factors: Factorization, R: Array, X: Array) -> Modes:
    """Return modes other than the rigid motions R, from a guess X of all modes."""
    small, count = precise.small, X.shape[1] - R.shape[1]
    inertia = small.times(small.M, R)

    def corrected(force: Array) -> Array:
        return _without(R, inertia, small.solve(factors, force))

    push = np.random.default_rng(2).standard_normal((small.system.n_q, _GUARDS))
    X = _without(R, inertia, X / np.sqrt(_squares(small, X)))
    X = np.hstack([distinct(X, small.times(small.M, X)), corrected(push)])
    X = X / np.sqrt(_squares(small, X))
    z, X = _ritz(precise, distinct(X, small.times(small.M, X)))
    if len(z) < count:
        raise NoModes(small.words(_TOO_THIN, _TOO_STIFF))
    for _ in range(_SWEEPS):
        last = z[:count]
        z, X = _ritz(precise, X + corrected(precise.left(X, z)))
        change = np.abs(z[:count] - last)
        sizes = np.abs(last) + small.round_off(small.K, X[:, :count])
        if np.all(change <= _SETTLED * sizes):
            z, X = z[:count], X[:, :count]
            # An error of R is in X, too: a component c / z of R, which changes z by c^2 / z.
            mixed = np.sum((R.T @ precise.times(X)) ** 2, axis=0) / np.abs(z)
            return z, X, np.maximum(_noise(precise, X, z), change) + mixed
    raise NoModes(small.words(_TOO_THIN, _TOO_STIFF))


def _without(R: Array, inertia: Array, X: Array) -> Array:
    """Return X without its components in orthonormal columns R; twice, for small remainders."""
    for _ in range(2):
        X = X - R @ (inertia.T @ X)
    return X


def _stiffness(small: Linearised) -> Array:
    """Return D = |diag K|, with a small least value per unit of weight, shape (n_q,).

    D serves as the shift of all motions: a motion with zero entries in D would stay singular.
    """
    w, D = small.system.weights, np.abs(small.K[small.system.pattern.diagonal])
    return np.asarray(np.maximum(D, _TRACE * np.max(D / w) * w) if np.any(D) else w)


def _shifted(small: Linearised, shift: float) -> Array:
    """Return the values of K + shift D, which is regular for rigid motions, shape (nnz,)."""
    P = small.K.copy()
    P[small.system.pattern.diagonal] += shift * _stiffness(small)
    return P


def _factors(small: Linearised, P: Array) -> Factorization:
    try:
        return small.saddle.factor(P, small.Phi_q)
    except SingularMatrix as error:
        raise NoModes(f"modes: {error}.") from error


def lost(z: Array, noise: Array) -> Array:
    """Return the indices of modes, not rigid, whose z has too much round-off."""
    return np.flatnonzero((z != 0) & (noise > ALLOWED * np.abs(z)))


def refuse_lost(small: Linearised, z: Array, noise: Array) -> None:
    """Raise NoModes if a mode that is not rigid has too much round-off in z."""
    missing = lost(z, noise)
    if not len(missing):
        return
    j = int(missing[0])
    size = np.abs(z[j])
    gaps = np.abs(np.delete(z, j) - z[j])
    moved = f"mode {j}: round-off moves its value by {noise[j] / size:.1g} of itself"
    if not small.symmetric or small.D is not None:
        gap = float(np.min(gaps, initial=np.inf))
        if gap <= ALLOWED**0.5 * size:
            repair = (
                "Change the load, the damping or the design by more than a millionth of itself."
                if z[j].imag or small.D is None
                else small.words(
                    "Motions that creep crowd next to -1 over the retardation time: shorten it, "
                    "ask for fewer modes, or pass damped=False.",
                    "Exponents of overdamped motions coincide: change the damping by more than a "
                    "millionth of itself, ask for fewer modes, or pass damped=False.",
                )
            )
            raise NoModes(
                f"{moved}; another one differs by {gap / size:.1g}, and next to a double root a "
                f"relative error e of the matrices becomes its root. {repair}"
            )
    balance = (
        ""
        if small.unbalanced == 0
        else "leave out the loads that are not in balance here, or linearise about an equilibrium "
        "(at=equilibrium(...)); or "
    )
    raise NoModes(
        f"{moved}: the stiffest motions are too many orders of magnitude stiffer than this one. To "
        f"keep more digits {balance}"
        + small.words(
            "use fewer elements, thicker sections or rigid bodies for the stiffest parts (the body "
            "is too thin for its numbers).",
            "constrain the stiffest motions.",
        )
    )


def _ritz(precise: Precise, Z: Array) -> tuple[Array, Array]:
    """Return Ritz values and shapes in the span of Z, increasing, the small values computed twice.

    Round-off of the largest value e mixes shapes by eps, which changes a quotient by eps^2 e.
    """
    Z = Z / np.sqrt(_squares(precise.small, Z))
    K, M = Z.T @ precise.times(Z), Z.T @ precise.small.times(precise.small.M, Z)
    try:
        z, Y = scipy.linalg.eigh((K + K.T) / 2, (M + M.T) / 2)
    except scipy.linalg.LinAlgError as error:  # Vectors converged to the same rigid motion.
        raise NoModes(precise.small.words(_TOO_THIN, _TOO_STIFF)) from error
    X, small = Z @ Y, np.abs(z) < EPS**0.5 * np.max(np.abs(z))
    if np.any(small):
        z[small], X[:, small] = _ritz(precise, X[:, small])
    return z, X


def _noise(precise: Precise, X: Array, z: Array) -> Array:
    """Return the round-off of z, (k,): the largest change of x^T K x by other roundings."""
    q, generator = precise.q, np.random.default_rng(3)
    quotients = np.einsum("ij,ij->j", X, precise.times(X))
    change = np.zeros(len(z))
    for _ in range(_ROUNDINGS):
        other = replace(precise, q=q * (1 + EPS * generator.choice([-1.0, 1.0], q.shape)))
        # A third of a shape is rounded differently, too.
        Y = X * (1 + EPS * generator.choice([-1.0, 1.0], X.shape))
        moved = 3.0 * np.einsum("ij,ij->j", Y, other.times(Y / 3.0))
        change = np.maximum(change, np.abs(moved - quotients))
    return np.asarray(_MARGIN * change + EPS * np.abs(z))


def _squares(small: Linearised, X: Array) -> Array:
    squares: Array = np.maximum(np.einsum("ij,ij->j", X, small.times(small.M, X)), 0.0)
    return squares
