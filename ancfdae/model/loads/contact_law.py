"""Contact forces: Hunt and Crossley's normal force, regularised Coulomb friction.

With the depth d of a contact and the normal relative speed w_n, positive where bodies separate,

    N = k d^n (1 - chi w_n)   while this is positive, else 0.

A free impact at the speed v ends at the speed e v, for all k, n and masses: with u = chi v

    u - ln(1 + u) = -e u - ln(1 - e u)    (docs/theory/19-contact.md).

Friction is -mu N w_t / (|w_t|^4 + w_s^4)^(1/4) for the tangential velocity w_t: 1 % below its limit
at |w_t| = 2.2 w_s, and a linear creep below.
"""

from typing import Any

import numpy as np

from ancfdae.errors.checks import require_finite
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.vector_formulas import concatenate, dot, positive

# Smallest restitution e; below it 1 - e u has too few digits.
_LEAST_RESTITUTION = 0.05
# Argument below which `_phi` is computed by its series, and the exponents of the series.
_SERIES, _TERMS = 0.3, np.arange(40.0)


def require_restitution(where: str, value: object) -> None:
    """Raise InvalidInputError unless a coefficient of restitution lies between 0.05 and 1."""
    require_finite(where, value)
    if not _LEAST_RESTITUTION <= value <= 1.0:  # type: ignore[operator]
        rule = f"must lie between {_LEAST_RESTITUTION} and 1"
        repair = "For plastic impacts use the event Impact(gap, restitution=0)."
        raise InvalidInputError(where, rule, value, repair)


def _phi(x: float) -> tuple[float, float]:
    """Return (x - ln(1 + x)) / x^2, which gives chi from the restitution, and its derivative."""
    if abs(x) < _SERIES:
        powers = (-x) ** _TERMS
        slope = -(_TERMS[1:] / (_TERMS[1:] + 2) * powers[:-1]).sum()
        return float((powers / (_TERMS + 2)).sum()), float(slope)
    value = (x - np.log1p(x)) / x**2
    return float(value), float((1 / (1 + x) - 2 * value) / x)


def damping_of(restitution: Any, speed: Any) -> Any:
    """Return the damping chi = u / v for restitution e at the impact speed v; s/m.

    The numbers may have an imaginary part (complex step).
    """
    e = float(np.real(restitution))

    def excess(u: float) -> float:
        return _phi(u)[0] - e**2 * _phi(-e * u)[0]

    import scipy.optimize

    u = scipy.optimize.brentq(excess, 0.0, (1 - 1e-12) / e, xtol=1e-300, rtol=1e-15)
    (_, slope), (inner, inner_slope) = _phi(u), _phi(-e * u)
    u_e = (2 * e * inner - e**2 * u * inner_slope) / (slope + e**3 * inner_slope)
    return (u + u_e * (restitution - e)) / speed


def normal_force(depth: Any, w_n: Any, stiffness: Any, exponent: float, chi: Any) -> Any:
    """Return the contact force k d^n (1 - chi w_n), not negative, N; chi None: undamped."""
    spring = stiffness * (depth if exponent == 1.0 else depth**exponent)
    return spring if chi is None else spring * positive(1.0 - chi * w_n)


def friction_force(N: Any, w_t: Any, friction: Any, slip_speed: Any) -> Any:
    """Return the friction force -mu N w_t / (|w_t|^4 + w_s^4)^(1/4), shape of w_t; N."""
    squared: Any = dot(w_t, w_t)
    return -friction * N / np.sqrt(np.sqrt(squared * squared + slip_speed**4)) * w_t


def moving_with(U: Any, V: Any, arm: Any) -> tuple[Any, Any]:
    """Return the components of an arm in the axes of its body, and the velocity of its end.

    U and V are the position and the axes of the point, (..., 1 + m, d), and their rates. The
    components are (..., m, 1), None without axes.
    """
    axes = U[..., 1:, :]
    if not axes.shape[-2]:
        return None, V[..., :1, :]
    parts = dot(axes, arm) / dot(axes, axes)
    return parts, V[..., :1, :] + (parts * V[..., 1:, :]).sum(axis=-2, keepdims=True)


def on_body(F: Any, parts: Any) -> Any:
    """Return the forces on position and axes of a point from a force F at the end of an arm."""
    return F if parts is None else concatenate([F, parts * F])


def split_velocity(w: Any, n: Any) -> tuple[Any, Any]:
    """Return the normal component, (..., 1, 1), and the tangential vector of a velocity w."""
    w_n = dot(w, n)
    return w_n, w - w_n * n
