"""Time points of a run, with quadrature and interpolation of functions on them.

A grid of degree p is a chain of panels of p + 1 time points that share their end points. Within a
panel a function is the polynomial of degree p through its values; quadrature and interpolation
integrate and evaluate that polynomial.

* p = 1: panels are single steps, quadrature is the trapezoidal rule and
  interpolation is linear. Second order, as HHT-I3.
* p = 3: time points are the stages of `Radau`, whose quadrature is exact to degree 4.
* p = 8: time points are Gauss-Lobatto points, and the quadrature is exact to
  degree 15; for integrators of high order.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import final

import numpy as np

from ancfdae.numerics.arrays import Array


@lru_cache(maxsize=32)
def box_rule(counts: tuple[int, ...]) -> tuple[Array, Array]:
    """Return a tensor quadrature rule on xi in [0, 1] and transverse coordinates in [-1/2, 1/2].

    There are points, shape (n_p, len(counts)), and weights that sum to one; n points along a
    direction integrate polynomials of degree 2 n - 1 exactly.
    """
    rules = [np.polynomial.legendre.leggauss(count) for count in counts]
    axes = [0.5 * (x + 1.0) if k == 0 else 0.5 * x for k, (x, _) in enumerate(rules)]
    points = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    weights = np.ones(1)
    for _, w in rules:
        weights = np.outer(weights, 0.5 * w).ravel()
    points.setflags(write=False)
    weights.setflags(write=False)
    return points, weights


LOBATTO_DEGREE = 8
# Number of time points of the polynomial that interpolates between steps of degree 1.
_NEAR = 4
# Times that differ by less than _SAME times the length of the run count as one.
_SAME = 1e-9
# Weights below _NONE times the largest one count as zero.
_NONE = 1e-12


def next_end(breakpoints: Iterable[float], t: float, t_end: float) -> float:
    """Return the first of the breakpoints after t, or the end of the run; s."""
    least = _SAME * t_end
    return min((x for x in breakpoints if t + least < x < t_end - least), default=t_end)


@final
@dataclass(frozen=True)
class TimeGrid:
    """Increasing times in panels of `degree` intervals, with quadrature and interpolation."""

    t: Array  # (n_t,)
    # Degree p of the polynomial of a panel; a run that ended early may have a last panel of fewer
    # time points, whose polynomial has a lower degree.
    degree: int

    @staticmethod
    def lobatto(t_end: float, panels: int) -> TimeGrid:
        """Return Gauss-Lobatto points in equal panels from 0 to `t_end`."""
        share = 0.5 * (_lobatto_points() + 1.0)
        left = np.arange(panels)[:, None]
        t = np.ones(panels * LOBATTO_DEGREE + 1)
        t[:-1] = ((left + share[None, :-1]) / panels).ravel()
        return TimeGrid(t * t_end, LOBATTO_DEGREE)

    def weights(self) -> Array:
        """Return quadrature weights of all time points, shape (n_t,); s."""
        w = np.zeros(len(self.t))
        if self.degree == 1:
            w[1:] += 0.5 * np.diff(self.t)
            w[:-1] += 0.5 * np.diff(self.t)
            return w
        whole = (len(self.t) - 1) // self.degree * self.degree
        for first, last in ((0, whole), (whole, len(self.t) - 1)):
            if last > first:
                panels = np.arange(first, last, min(self.degree, last - first))[:, None]
                rows = panels + np.arange(min(self.degree, last - first) + 1)
                np.add.at(w, rows, _panel_weights(self.t[rows]))
        # Radau's quadrature has no weight at the start of a step: not even round-off.
        w[np.abs(w) < _NONE * np.max(np.abs(w))] = 0.0
        return w

    def interpolation(self, time: float) -> tuple[slice, Array]:
        """Return the slice of time points and the weights that interpolate a value at `time`.

        The polynomial passes through the points `around` the time; a time within 1e-12 of the end
        time of a time point counts as that point.
        """
        t = self.t
        nearest = len(t) - 1 if time == t[-1] else int(np.argmin(np.abs(t - time)))
        if abs(t[nearest] - time) <= 1e-12 * t[-1]:
            return slice(nearest, nearest + 1), np.ones(1)
        panel = self.around(time)
        return panel, _lagrange(t[panel], time)

    def around(self, time: float) -> slice:
        """Return the slice of time points whose polynomial interpolates at `time`.

        It is the panel; for degree 1 four points around the time, since straight lines would leave
        derivatives with respect to the time to first order.
        """
        count, degree = len(self.t), self.degree
        step = max(int(np.searchsorted(self.t, time)) - 1, 0)
        if degree == 1:
            first = min(max(step - 1, 0), max(count - _NEAR, 0))
            return slice(first, min(first + _NEAR, count))
        left = step - step % degree
        return slice(left, min(left + degree + 1, count))


@lru_cache(maxsize=1)
def _lobatto_points() -> Array:
    # NumPy 2.3 returns real roots as complex numbers.
    inner = np.polynomial.legendre.Legendre.basis(LOBATTO_DEGREE).deriv().roots().real
    points = np.concatenate([[-1.0], np.sort(inner), [1.0]])
    points.setflags(write=False)
    return points


def _panel_weights(t: Array) -> Array:
    """Return integrals of the Lagrange polynomials of panels, (k, p + 1).

    They are exact for Legendre polynomials up to degree p.
    """
    half = 0.5 * (t[:, -1:] - t[:, :1])
    x = (t - 0.5 * (t[:, :1] + t[:, -1:])) / half
    integrals = np.zeros((*t.shape, 1))
    integrals[:, 0] = 2.0 * half
    V = np.polynomial.legendre.legvander(x, t.shape[1] - 1)
    return np.asarray(np.linalg.solve(V.swapaxes(1, 2), integrals)[..., 0])


def _lagrange(t: Array, time: float) -> Array:
    """Return the values of the Lagrange polynomials of the time points t at `time`."""
    gaps, ahead = t[:, None] - t, np.tile(time - t, (len(t), 1))
    np.fill_diagonal(gaps, 1.0)
    np.fill_diagonal(ahead, 1.0)
    return np.asarray(np.prod(ahead / gaps, axis=1))
