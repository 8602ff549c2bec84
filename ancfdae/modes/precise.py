"""Lowest modes of thin bodies, whose K as a matrix has lost them.

An entry of K is a sum of axial and shear stiffness; of bending (h/L)^2 of it is left, and n
elements leave 1/n^2 of that: x^T K x rounds to eps |x|^T |K| |x|, of the size of z itself at
h/L = 1e-6. Element by element, K x is the force of strains, in which what turns rigidly cancels
before it meets a stiffness: right to eps (l/h)^2, l the length of an element, which 8 elements
make 4,096 times less. Coordinates, too, are too coarse: nodes that round to eps |q| leave an axial
force of eps EA. Where forces are in balance to round-off, what Newton's method would add below the
last digit takes it out (as in `statics.equilibrium`).

Inverse iteration on a block finds the modes: such products give its residual, the factorised
matrix turns it into a correction, and Ritz's method gives the values. Their round-off is estimated
by another rounding of coordinates and shapes.
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

# Round-off of z, twice that of a frequency, above which products with the matrix do not do, and
# above which modes are rejected. The bound that decides on products is 50 times what it bounds.
ALLOWED = 2e-6
# Vectors beside those asked for; with them a sweep gains a digit or more in a beam.
_GUARDS, _SWEEPS = 8, 60
# Sweeps end where values change by less of themselves, or of what the matrix would round them by.
_SETTLED = 1e-7
# As in `statics.softness`: a shift, and the part of the stiffest that counts where D is less.
_SHIFT, _TRACE = 1e-14, 1e-8
# What is stiff: axial forces, 1/n^2 of the diagonal, and neither bending nor rigid motions.
_STIFF = 1e-10
# Rigid motions searched for at first; their number is multiplied by _MORE as long as all motions
# found are rigid; and sweeps.
_FIRST, _MORE, _CLEANED = 8, 4, 3
# Round-off is estimated as _MARGIN times the largest change under _ROUNDINGS other roundings.
_MARGIN, _ROUNDINGS = 4.0, 3
# As in `statics.equilibrium`.
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
    """Modes that did not converge, or that round-off has taken."""


@final
@dataclass(frozen=True)
class Precise:
    """K about coordinates q, applied element by element."""

    small: Linearised
    q: Array
    stiff: Factorization

    @cached_property
    def _beyond(self) -> tuple[Array, Array]:
        """Corrections of q and lam below the last digit of q, by one step of Newton's method.

        The forces that they balance are those left over in an equilibrium; out of balance those of
        stresses that the rounding of a body free of stress leaves, less their reactions. Zero where
        bodies carry other stresses out of balance: those cannot be told from round-off.
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
            # The reactions that multipliers of the configuration hold for these forces.
            at_q = system.stress_force(at.q)
            R = R - reaction(system, at.t, self.q, solve(self.small.mass_factors, at_q, none)[1])
        return solve(self.stiff, R, none)

    def times(self, X: Array) -> Array:
        """Return K X for real columns."""
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
        """Return M X z - K X."""
        return self.small.times(self.small.M, X) * z - self.times(X)


def precise_modes(small: Linearised, X: Array) -> Modes:
    """Return as many of the lowest modes of a symmetric pencil as there are columns in X.

    Inverse iteration on a block: x - P^-1 (K x - z M x) is z K^-1 M x where P is K. Beside rigid
    motions, which P makes the largest, all others would be round-off: they are found first, and
    the block has no part of them.

    Raises
    ------
    NoModes
        If they do not converge.
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
    """Return all of them, orthonormal in M; `factors` are those of P = K + shift D, D = |diag K|.

    The block grows until it contains a motion stiffer than shift D: all that are softer, rigid or
    not, keep their size, and Ritz's method tells them apart only where all of them are in it.

    x - P^-1 K x leaves them as they are, and of others what shift D is of P. In the norm of D a
    spin about the axis of a thin body counts as much as a translation.

    Bending may be as soft as shift D. It has a stiffness that is not round-off of products, nor
    that of parts eps of itself and of the stiffest shapes.
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
    """Return an orthonormal basis of columns, of every part that is more than their round-off."""
    U, sizes, _ = np.linalg.svd(X / np.linalg.norm(X, axis=0), full_matrices=False)
    return np.asarray(U[:, sizes > ROUND_OFF * EPS * sizes[0]])


def _elastic_modes(precise: Precise, factors: Factorization, R: Array, X: Array) -> Modes:
    """Modes beside rigid motions R, from a guess X of all of them."""
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
            # What is wrong with R is in X, too: a part c / z of R, which moves z by c^2 / z.
            mixed = np.sum((R.T @ precise.times(X)) ** 2, axis=0) / np.abs(z)
            return z, X, np.maximum(_noise(precise, X, z), change) + mixed
    raise NoModes(small.words(_TOO_THIN, _TOO_STIFF))


def _without(R: Array, inertia: Array, X: Array) -> Array:
    """Return columns without their parts of orthonormal ones; twice, for the round-off of large."""
    for _ in range(2):
        X = X - R @ (inertia.T @ X)
    return X


def _stiffness(small: Linearised) -> Array:
    """Return D = |diag K|, and at least a trace of the stiffest by weight.

    It serves as the shift of all motions at once: one that D leaves out would stay singular.
    """
    w, D = small.system.weights, np.abs(small.K[small.system.pattern.diagonal])
    return np.asarray(np.maximum(D, _TRACE * np.max(D / w) * w) if np.any(D) else w)


def _shifted(small: Linearised, shift: float) -> Array:
    """Return values of K + shift D, which rigid motions do not make singular."""
    P = small.K.copy()
    P[small.system.pattern.diagonal] += shift * _stiffness(small)
    return P


def _factors(small: Linearised, P: Array) -> Factorization:
    try:
        return small.saddle.factor(P, small.Phi_q)
    except SingularMatrix as error:
        raise NoModes(f"modes: {error}.") from error


def lost(z: Array, noise: Array) -> Array:
    """Return the numbers of modes, not rigid, of whose values round-off takes too much."""
    return np.flatnonzero((z != 0) & (noise > ALLOWED * np.abs(z)))


def refuse_lost(small: Linearised, z: Array, noise: Array) -> None:
    """Refuse modes that are not rigid and whose values round-off moves by too much."""
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
    """Ritz's method, again for values below the digits of the largest; by growing value.

    Round-off of the largest value e turns shapes by eps, by which a quotient is off by eps^2 e.
    """
    Z = Z / np.sqrt(_squares(precise.small, Z))
    K, M = Z.T @ precise.times(Z), Z.T @ precise.small.times(precise.small.M, Z)
    try:
        z, Y = scipy.linalg.eigh((K + K.T) / 2, (M + M.T) / 2)
    except scipy.linalg.LinAlgError as error:  # Vectors became one and the same rigid motion.
        raise NoModes(precise.small.words(_TOO_THIN, _TOO_STIFF)) from error
    X, small = Z @ Y, np.abs(z) < EPS**0.5 * np.max(np.abs(z))
    if np.any(small):
        z[small], X[:, small] = _ritz(precise, X[:, small])
    return z, X


def _noise(precise: Precise, X: Array, z: Array) -> Array:
    """Round-off in z: the most that other roundings of the coordinates change in x^T K x."""
    q, generator = precise.q, np.random.default_rng(3)
    quotients = np.einsum("ij,ij->j", X, precise.times(X))
    change = np.zeros(len(z))
    for _ in range(_ROUNDINGS):
        other = replace(precise, q=q * (1 + EPS * generator.choice([-1.0, 1.0], q.shape)))
        # A third of a shape rounds otherwise, too.
        Y = X * (1 + EPS * generator.choice([-1.0, 1.0], X.shape))
        moved = 3.0 * np.einsum("ij,ij->j", Y, other.times(Y / 3.0))
        change = np.maximum(change, np.abs(moved - quotients))
    return np.asarray(_MARGIN * change + EPS * np.abs(z))


def _squares(small: Linearised, X: Array) -> Array:
    squares: Array = np.maximum(np.einsum("ij,ij->j", X, small.times(small.M, X)), 0.0)
    return squares
