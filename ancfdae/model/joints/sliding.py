"""Sliding joint: the centre line of a beam or cable runs through a point of a body or the ground.

The arc length s of the line at the guide is an additional coordinate. The line is the sum of the
contributions of all elements up to s,

    r(s) = r_0 + sum_k [r_k(xi_k) - r_k(0)],   xi_k = (s - s_k) / l_k between 0 and 1,

with r_k the cubic of element k. Position and slope of the line are continuous at nodes: passing a
node needs no event (docs/theory/20-cables.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from ancfdae.errors.checks import require_finite, require_positive, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, Quantity
from ancfdae.model.design import design_numbers
from ancfdae.model.joints.joint import FormulaJoint
from ancfdae.model.parts import Elements, LineVector, Sign, StateVector, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.vector_formulas import positive

# Locations xi along an element whose positions, with its end, define its cubic.
_THIRDS = (0.0, 1 / 3, 2 / 3)


def _require_inside(where: str, value: object) -> None:
    """Raise InvalidInputError unless a fraction of the beam lies between its ends."""
    require_finite(where, value)
    if not 0.0 < value < 1.0:  # type: ignore[operator]
        rule = "must lie between 0 and 1, the ends of the beam"
        raise InvalidInputError(where, rule, value, "Start the guide between the ends.")


@final
@dataclass(frozen=True)
class SlidingJoint(FormulaJoint):
    """Let a beam or cable slide through a guide: a point of a body, or a point on the ground.

    The guide stays on the centre line, r(other) - r(s) = 0, and the arc length s, counted along the
    beam in the reference configuration, is a coordinate of the joint. It starts at `fraction` of
    the length L with the rate `speed`. The multipliers are minus the force of the beam on the
    guide. Without a `SlidingFriction` the force along the beam is m_r s'', with m_r the
    `rolling_mass`. A run whose guide leaves the beam ends there with a message. The beam must not
    have kinks where the guide passes. Design targets: ``fraction``, ``speed``, and ``ground_x`` ...
    to ground.

    Parameters
    ----------
    beam : str
        Name of the beam or cable.
    other : MaterialPoint, optional
        The guide, a point of another body.
    ground : sequence of float, optional
        The guide, a position on the ground; m. Give either `other` or `ground`.
    fraction : float
        Arc-length fraction of the guide on the beam at t = 0, between 0 and 1 (dimensionless).
    rolling_mass : float
        m_r, positive; kg. A guide with rollers of moment of inertia J and radius R has J/R^2. For a
        bead take a small part of its mass: it is that much heavier along the beam.
    speed : float, optional
        s' at t = 0; m/s. It must fit the velocities of the beam and the guide.
    """

    beam: str
    other: MaterialPoint | None = None
    ground: Sequence[float] | None = None
    fraction: float = field(kw_only=True)
    rolling_mass: float = field(kw_only=True)
    speed: float = field(default=0.0, kw_only=True)

    kind = "slide"
    sign = Sign("sliding joint", "o")
    needs_other_end = True
    holds_position = True
    states = ("travel",)
    routed = True
    design_fields = (
        ("ground", require_vector),
        ("fraction", _require_inside),
        *design_numbers("speed"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(f"joint {self.name!r}, rolling_mass", self.rolling_mass)

    def row_count(self, d: int) -> int:
        """Return 2d - 1: d for the position of the guide, d - 1 for unused components of s."""
        return 2 * d - 1

    def state_masses(self) -> tuple[float, ...]:
        """Return the inertia of the arc length s, `rolling_mass`; kg."""
        return (self.rolling_mass,)

    def initial_states(self, p: Array) -> Sequence[Any]:
        """Return the rate of the arc length s at t = 0; m/s."""
        return [self.split(p)[2]]

    def vectors(self, elements: Elements) -> Vectors:
        """Return the guide, positions along the beam from its start to its end, and s."""
        count = elements.counts[self.beam]
        at = [(k, xi) for k in range(count) for xi in _THIRDS]
        line = (LineVector(self.beam, *x, Quantity.POSITION) for x in (*at, (count - 1, 1.0)))
        guide = tuple((point, Quantity.POSITION) for point in self.points)
        return (*guide, *line, StateVector(self.name, 0))

    def equations(self, U: Array, p: Array, reference: Array, laws: Array) -> Any:
        """Return the gap between guide and line, and the unused components of the vector of s."""
        ground, fraction, _ = self.split(p)
        first = len(self.points)
        l = element_lengths(reference[first:-1])
        s = fraction * sum(l) + U[-1, 0]
        gap = (U[0] if self.points else ground) - line_at(s, U[first:-1], l)
        return np.concatenate([gap, U[-1, 1:]])

    def off_route(
        self, t: Array, U: Array, V: Array, p: Array, U_o: Array
    ) -> tuple[int, str] | None:
        """Return the index of the first state with the guide beyond an end, and a message."""
        L = sum(element_lengths(U_o[len(self.points) : -1].real))
        s = self.split(p)[1].real * L + U[:, -1, 0].real
        low, high = _reached(t, s, V[:, -1, 0].real)
        off = np.flatnonzero((low < 0) | (high > L))
        if not len(off):
            return None
        end = "start" if low[off[0]] < 0 else "end"
        return int(off[0]), (
            f"takes the guide of joint {self.name!r} beyond the {end} of beam {self.beam!r}. Stop "
            "the run before with an EndEvent of slide_distance, take a longer beam, or brake the "
            "guide with a SlidingFriction"
        )


def _reached(t: Array, s: Array, s_t: Array) -> tuple[Array, Array]:
    """Return least and largest arc length between each time and the one before, (k,) each; m.

    Between two times the arc length is the cubic through arc lengths and rates.
    """
    h, a, b = np.diff(t), s_t[:-1], s_t[1:]
    mean = np.diff(s) / h
    # Zeros in (0, 1) of the rate a + 2 (3 m - 2 a - b) x + 3 (a + b - 2 m) x^2, m its mean.
    half, square = 3 * mean - 2 * a - b, 3 * (a + b - 2 * mean)
    with np.errstate(all="ignore"):
        part = -(half + np.where(half < 0, -1.0, 1.0) * np.sqrt(half**2 - a * square))
        x = np.stack([part / square, a / part])
        x = np.where((x > 0) & (x < 1), x, 0.0)
    turns = s[:-1] + h * x * (a + x * (half + x * square / 3))
    low, high = s.copy(), s.copy()
    low[1:] = np.minimum(low[1:], np.min(turns, axis=0))
    high[1:] = np.maximum(high[1:], np.max(turns, axis=0))
    return low, high


def element_lengths(X: Array) -> list[Any]:
    """Return the lengths of elements from reference positions at their thirds, (3n + 1, d).

    Slopes have unit length there, so that each length is the norm of the derivative in xi.
    """
    rates = (-11 * X[:-1:3] + 18 * X[1::3] - 9 * X[2::3] + 2 * X[3::3]) / 2
    return [np.sqrt((x * x).sum()) for x in rates]


def line_at(s: Any, X: Array, l: Sequence[Any]) -> Any:
    """Return the point at arc length s, (d,), of a line with positions X, (3n + 1, d); m."""
    r, last = X[0], len(l) - 1
    for k, length in enumerate(l):
        xi = s / length
        # Beyond its ends the line is the cubic of its first or last element.
        low = xi if k == 0 else positive(xi)
        xi = low if k == last else low - positive(xi - 1)
        one, two, end = xi - 1 / 3, xi - 2 / 3, xi - 1
        weights = 13.5 * xi * two * end, -13.5 * xi * one * end, 4.5 * xi * one * two
        for weight, x in zip(weights, X[3 * k + 1 : 3 * k + 4], strict=True):
            r = r + weight * (x - X[3 * k])
        s = s - length
    return r
