"""Masses of the vectors of states, so that a state counts in norms as the motion does.

A state x of a controller is the rate of a vector with a mass w, w x' = w f. The motion does not
depend on w, but norms of forces and velocities do, by which iterations and tolerances are measured.
With W the weights of the coordinates q of the mechanism, at the start,

    g = |Q_x|,   e = |f_q|,   d = |f_v|   in the norm of 1/W,

1/T is the largest of the rates |f_x|, (g d)^(1/2) and (g e)^(1/3): of the state by itself, and of
the loop that it closes with the mechanism. Then w = (g T)^2: sqrt(w) x is the velocity, in the norm
of W, that the forces of x cause in the time T. A state that acts on no axis has
w = 1/(e T^2)^2 or 1/(d T)^2, the same from its input; one that only meets other states has theirs
through f_x. The unit of w is an energy over x^2, so that units and places do not matter.

Where all these partials are zero at the start, as of an effort with the square of a state that
starts from zero, w = (l / (T X))^2 with the size l of the mechanism in the norm of W and the size
X of the state, the largest of |x|, T |f| and T^2 |f_t|. If all of those rates are
zero, 1/T is |f_t| / |f|.
"""

import numpy as np

from ancfdae.assembly.load_input import LoadInput
from ancfdae.numerics.arrays import STEP, Array


@np.errstate(all="ignore")
def state_masses(item: LoadInput, weights: Array, size: float) -> Array:
    """Return the masses of the vectors of the states of a load, shape (n_states,).

    One where all partials and rates vanish, or numbers overflow. `weights` belong to the
    coordinates of the mechanism, (n_q,), and `size` is its size in their norm.
    """
    n = len(item.masses)
    Q_x, f_q, f_v, f_x = _partials(item)
    of_coordinates = (np.sqrt(np.sum(x**2 / weights, axis=1)) for x in (Q_x, f_q, f_v))
    g, e, d = of_coordinates
    rates = np.max([np.abs(np.diag(f_x)), np.sqrt(g * d), np.cbrt(g * e)], axis=0)
    x, f, f_t = _first_rates(item)
    of_time = np.where((rates == 0) & (np.abs(f) > 0), np.abs(f_t / f), 0.0)
    rates = np.where(rates > 0, rates, np.max(rates) or of_time)
    T = 1 / np.where(rates > 0, rates, 1.0)
    root = g * T
    for from_input in (1 / _or_infinite(e * T**2), 1 / _or_infinite(d * T)):
        root = np.where(root > 0, root, from_input)
    # Root by root from states that meet the mechanism to those that meet these.
    for _ in range(n):
        for j, k in np.argwhere((root[:, None] == 0) & (root > 0)).tolist():
            out, into = abs(f_x[k, j]) * T[k], abs(f_x[j, k]) * T[j]
            root[j] = root[j] or (root[k] * out if out else root[k] / into if into else 0.0)
    expected = np.max(np.abs([x, T * f, T**2 * f_t]), axis=0)
    root = np.where(root > 0, root, size / _or_infinite(T * expected))
    masses = root**2
    return np.where((masses > 0) & np.isfinite(masses), masses, 1.0)


def _or_infinite(x: Array) -> Array:
    return np.where(x > 0, x, np.inf)


def _first_rates(item: LoadInput) -> tuple[Array, Array, Array]:
    """Return the states, their rates f and the partials f_t in time at the start, (n,) each."""
    U, V, first = _at_start(item)
    signals, rates = (item.factors(np.zeros(1), k)[0, 1:] for k in (0, 1))
    F = item.force(U + 0j, V + 0j, signals + 1j * STEP * rates)[first:, 0]
    return V[first:, 0], F.real, F.imag / STEP


def _at_start(item: LoadInput) -> tuple[Array, Array, int]:
    """Return U in the reference configuration, V of the states alone, and the first state."""
    U = item.reference.real
    first, V = len(U) - len(item.masses), np.zeros_like(U)
    V[first:, 0] = np.real(item.load.initial_states(item.p.real))
    return U, V, first


def _partials(item: LoadInput) -> tuple[Array, Array, Array, Array]:
    """Return rows Q_x, f_q and f_v, (n, n_q) each, and f_x, (n, n), at the start of the states.

    The mechanism stands in its reference configuration; masses in `item` are one.
    """
    n, (U, V, first) = len(item.masses), _at_start(item)
    signals, lift = item.factors(np.zeros(1), 0)[0, 1:], item.vectors.lift
    steps = 1j * STEP * np.eye(U.size).reshape(-1, *U.shape)
    F_U, F_V = (
        np.imag(item.force(*moved, signals)) / STEP
        for moved in ((U + steps, V + 0 * steps), (U + 0 * steps, V + steps))
    )
    rates = F_U[:, first:, 0].T.reshape(n, *U.shape), F_V[:, first:, 0].T.reshape(n, *U.shape)
    mechanism = np.arange(len(U))[:, None] < first
    of_states = F_V.reshape(*U.shape, *U.shape)[first:, 0]
    f_q, f_v = (lift(x * mechanism) for x in rates)
    return lift(of_states * mechanism), f_q, f_v, of_states[:, first:, 0].T
