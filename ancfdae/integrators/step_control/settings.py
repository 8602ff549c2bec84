"""Contracts of step control: what a user sets, and what decides in a run."""

from __future__ import annotations

import abc
import math
import sys
from typing import Any

from ancfdae.errors import InvalidInput, Verdict
from ancfdae.integrators.step_control.one_step_method import OneStepMethod
from ancfdae.integrators.step_control.tolerance import Tolerance
from ancfdae.numerics.arrays import Array


class Controller(abc.ABC):
    """Decides the steps of a run; of the method it sees numbers only."""

    @abc.abstractmethod
    def plan(self, n: int, t: float) -> tuple[float, float] | Verdict:
        """Return size and end of the step after instant n at time t, or how the run ends there."""

    @abc.abstractmethod
    def judge(self, n: int, t: float, h: float, error: float | None) -> int | Verdict:
        """Judge a step of size h from instant n at time t by its e; None if it was not solved.

        Returns
        -------
        int or Verdict
            The instant to go on from: n + 1 if the step counts, n if another size is to be tried,
            0 if the run begins anew; or why no step helps.
        """


class StepControl(abc.ABC):
    """Frozen settings of how the steps of a run are chosen."""

    @abc.abstractmethod
    def count(self, t_end: float) -> int:
        """Return the number of steps to `t_end`, or a guess where nobody knows.

        Raises
        ------
        InvalidInput
            If no step can end there.
        """

    @abc.abstractmethod
    def tolerance(self, t_end: float, sizes: Array, sizes_b: Array) -> Tolerance | None:
        """Return what measures the error of a step; None where nothing depends on it."""

    @abc.abstractmethod
    def controller(self, t_end: float, method: OneStepMethod[Any]) -> Controller:
        """Return what decides the steps of one run."""

    @abc.abstractmethod
    def sizes(self, t: Array) -> Array:
        """Return the steps of a run with the instants t."""

    @abc.abstractmethod
    def frozen(self, t: Array) -> StepControl:
        """Return what repeats the steps of a run with the instants t, whatever the design."""

    @abc.abstractmethod
    def refined(self, t: Array) -> StepControl:
        """Return what halves every step of a run with the instants t."""


def require_square(where: str, value: float) -> None:
    """Refuse times whose square, or its inverse, is no number of full precision.

    Raises
    ------
    InvalidInput
    """
    if not sys.float_info.min < value * value < math.inf:
        raise InvalidInput(where, "must have a square that is a number", value, "Change units.")
