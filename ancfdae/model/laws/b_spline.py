"""Smooth curve between bounds that control values set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np
import scipy

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.design import require_numbers
from ancfdae.model.laws.law import Law
from ancfdae.numerics.arrays import Array, Numbers

# The least degree with three continuous derivatives.
_DEGREE = 4


@final
@dataclass(frozen=True)
class BSpline(Law):
    """A spline of degree four that stays between the least and the largest of its control values.

    Each value weighs a hill over five equal spans of time; the weights add up to one at all times.
    Bounds of the values are therefore bounds of the law: an optimiser shapes a torque within
    the limits of its motor. Before `begin` the law has the first value, after `end` the last one;
    three derivatives are continuous. It does not pass through the values between (`Spline` does).
    Design targets: ``value[0]``, ``value[1]`` ...

    Parameters
    ----------
    begin, end : float
        Times between which the law changes; s.
    values : sequence of float
        Two or more control values, evenly over that time; the unit of what the law drives.
    """

    begin: float
    end: float
    values: Numbers

    marked = True
    design_fields = (("values", require_numbers),)
    indexed_fields: ClassVar[Mapping[str, str]] = {"values": "value"}

    def check(self) -> None:
        """Refuse times and values that do not fit."""
        require_numbers("BSpline, times", (self.begin, self.end))
        if not self.begin < self.end:
            repair = "For example BSpline(0.0, 2.0, [0.0, 5.0, -5.0, 0.0])."
            rule = f"must be later than begin, {self.begin:g}"
            raise InvalidInputError("BSpline, end", rule, self.end, repair)
        if len(self.values) < 2:
            repair = "Give two values or more; one is a Constant."
            raise InvalidInputError("BSpline, values", "must be several", self.values, repair)

    def breakpoints(self, p: Array) -> tuple[float, ...]:
        """Begin and end; the fourth derivative also jumps at the knots between them."""
        return float(self.begin), float(self.end)

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Sum of control values times derivatives of their hills, shape of t."""
        spans = len(p) + _DEGREE
        s = np.clip((np.asarray(t) - self.begin) * spans / (self.end - self.begin), 0.0, spans)
        # Values go on as the first and the last, so that the ends are constant.
        held = np.concatenate([np.repeat(p[:1], _DEGREE), p, np.repeat(p[-1:], _DEGREE)])
        x = self._hills(s, nu=order) @ held * (spans / (self.end - self.begin)) ** order
        return np.where((s > 0.0) & (s < spans), x, 0.0) if order else np.asarray(x)

    @cached_property
    def _hills(self) -> scipy.interpolate.BSpline:
        """Weights of all control values over the number of the span."""
        count = len(self.values) + 2 * _DEGREE
        knots = np.arange(-_DEGREE, count + 1.0)
        return scipy.interpolate.BSpline(knots, np.eye(count), _DEGREE)
