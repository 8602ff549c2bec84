"""Smooth curves: through control values, or between bounds set by control values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np
import scipy

from ancfdae.errors.checks import require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.design import require_numbers
from ancfdae.model.laws.law import Law
from ancfdae.numerics.arrays import Array, Numbers

# Lowest degree of splines with three continuous derivatives.
_LOCAL_DEGREE = 4


@final
@dataclass(frozen=True)
class BSpline(Law):
    """A spline of degree four that stays between the smallest and largest of its control values.

    Each value multiplies a B-spline over five equal spans of time; these add up to one at all
    times. Bounds of the values are therefore bounds of the law: an optimiser shapes a torque within
    the limits of its motor. Before `begin` the law has the first value, after `end` the last one;
    three derivatives are continuous. It does not pass through the values between (`Spline` does).
    Design targets: ``value[0]``, ``value[1]`` ...

    Parameters
    ----------
    begin, end : float
        Times between which the law changes; s.
    values : sequence of float
        Two or more control values, evenly over that time, in the unit of the driven quantity.
    """

    begin: float
    end: float
    values: Numbers

    marked = True
    design_fields = (("values", require_numbers),)
    indexed_fields: ClassVar[Mapping[str, str]] = {"values": "value"}

    def check(self) -> None:
        """Raise InvalidInputError unless begin < end and there are two values or more."""
        require_numbers("BSpline, times", (self.begin, self.end))
        if not self.begin < self.end:
            repair = "For example BSpline(0.0, 2.0, [0.0, 5.0, -5.0, 0.0])."
            rule = f"must be later than begin, {self.begin:g}"
            raise InvalidInputError("BSpline, end", rule, self.end, repair)
        if len(self.values) < 2:
            repair = "Give two values or more; one is a Constant."
            raise InvalidInputError("BSpline, values", "must be several", self.values, repair)

    def breakpoints(self, p: Array) -> tuple[float, ...]:
        """Return begin and end, s; the fourth derivative also jumps at the knots between them."""
        return float(self.begin), float(self.end)

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return the time derivative of this order of the B-spline, shape of t."""
        spans = len(p) + _LOCAL_DEGREE
        s = np.clip((np.asarray(t) - self.begin) * spans / (self.end - self.begin), 0.0, spans)
        # The first and last values are repeated, so that the law is constant beyond its ends.
        held = np.concatenate(
            [np.repeat(p[:1], _LOCAL_DEGREE), p, np.repeat(p[-1:], _LOCAL_DEGREE)]
        )
        x = self._hills(s, nu=order) @ held * (spans / (self.end - self.begin)) ** order
        return np.where((s > 0.0) & (s < spans), x, 0.0) if order else np.asarray(x)

    @cached_property
    def _hills(self) -> scipy.interpolate.BSpline:
        """B-spline basis functions, one per control value, over t in units of the knot distance."""
        count = len(self.values) + 2 * _LOCAL_DEGREE
        knots = np.arange(-_LOCAL_DEGREE, count + 1.0)
        return scipy.interpolate.BSpline(knots, np.eye(count), _LOCAL_DEGREE)


# -- curves through values ---------------------------------------------------------------------


# Lowest odd degree of splines that can have three given derivatives at each end.
_SPLINE_DEGREE = 7


@final
@dataclass(frozen=True)
class Spline(Law):
    """The interpolating spline of degree seven through control values at given times.

    Before the first and after the last time it is constant, and its first three derivatives vanish
    there, so that they are continuous everywhere: a drive starts and ends at rest. A spline with a
    `period` repeats instead; one through two values is a `SmoothStep`. Between equidistant times it
    exceeds the largest value at most 2.5 times; at very uneven times much more. Design targets:
    ``value[0]``, ``value[1]`` ...

    Parameters
    ----------
    times : sequence of float
        Two or more ascending times; s.
    values : sequence of float
        Control values, one per time, in the unit of the driven quantity.
    period : float, optional
        Time after which the law repeats, longer than from the first time to the last; s.
    """

    times: Numbers
    values: Numbers
    period: float | None = None

    marked = True
    design_fields = (("values", require_numbers),)
    indexed_fields: ClassVar[Mapping[str, str]] = {"values": "value"}

    def check(self) -> None:
        """Raise InvalidInputError unless times ascend and the last lies within the period."""
        require_numbers("Spline, times", self.times)
        if len(self.times) < 2 or np.any(np.diff(self.times) <= 0):
            repair = "Give two times or more in ascending order."
            raise InvalidInputError("Spline, times", "must ascend", list(self.times), repair)
        if len(self.values) != len(self.times):
            got = f"{len(self.values)} values at {len(self.times)} times"
            raise InvalidInputError("Spline, values", "must be one per time", got)
        if self.period is None:
            return
        require_positive("Spline, period", self.period)
        span = self.times[-1] - self.times[0]
        if self.period <= span:
            repair = "The first value returns one period after the first time: leave it out there."
            rule = f"must exceed the {span:g} from the first time to the last"
            raise InvalidInputError("Spline, period", rule, self.period, repair)

    def breakpoints(self, p: Array) -> tuple[float, ...]:
        """Return the first and last time, s; between them six derivatives are continuous."""
        return () if self.period is not None else (float(self.times[0]), float(self.times[-1]))

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return the time derivative of this order of the spline, shape of t."""
        s = (np.asarray(t) - self.times[0]) / self._unit
        last = self._basis.t[-_SPLINE_DEGREE - 1]
        # The basis of a periodic spline repeats by itself.
        inside = s if self.period is not None else np.clip(s, 0.0, last)
        N = self._basis(inside, nu=order)
        if order and self.period is None:
            N = N * ((s > 0.0) & (s < last))[..., None]
        return N @ p / self._unit**order

    @property
    def _unit(self) -> float:
        """Mean distance of the control times, the time unit of the basis functions; s."""
        return float(self.times[-1] - self.times[0]) / (len(self.times) - 1)

    @cached_property
    def _basis(self) -> scipy.interpolate.BSpline:
        """Splines, one per control value, that are 1 at its time and 0 at all other times."""
        s = (np.array(self.times, dtype=float) - self.times[0]) / self._unit
        one = np.eye(len(s))
        if self.period is not None:
            s, one = np.append(s, self.period / self._unit), np.vstack([one, one[:1]])
            return scipy.interpolate.make_interp_spline(
                s, one, k=_SPLINE_DEGREE, bc_type="periodic"
            )
        ends = [(order, np.zeros(len(s))) for order in (1, 2, 3)]
        return scipy.interpolate.make_interp_spline(s, one, k=_SPLINE_DEGREE, bc_type=(ends, ends))
