"""What control of the step needs of a method."""

from __future__ import annotations

import abc
from typing import ClassVar, Generic, TypeVar

from ancfdae.errors import Verdict
from ancfdae.numerics.arrays import Array

# What a method knows at an instant.
State = TypeVar("State")
# Time, q, v, a, lam and, where they go along, q_b, v_b, a_b, lam_b.
Record = tuple[float, Array, Array, Array, Array, tuple[Array, ...]]


class OneStepMethod(abc.ABC, Generic[State]):
    """A run of a method that goes from state to state; how far, others decide.

    Attributes
    ----------
    order : int
        Power of the step with which its error per unit of time falls.
    """

    order: ClassVar[int]

    @abc.abstractmethod
    def consistent(self) -> Record:
        """Return what a solution keeps of the start, which is the consistent one."""

    @abc.abstractmethod
    def start(self, h: float) -> State:
        """Return the start of a run whose first step has the size h."""

    @abc.abstractmethod
    def resized(self, state: State, ratio: float) -> State:
        """Return a state for a step whose size is `ratio` times that of the step before."""

    @abc.abstractmethod
    def advance(self, h: float, before: State, t: float) -> State | None:
        """Return the state at t, after a step of size h; None if its equations were not solved.

        Raises
        ------
        SingularMatrix
        """

    @abc.abstractmethod
    def failure(self) -> tuple[Verdict, float]:
        """Return why the last step was not solved, and the size of its last correction."""

    @abc.abstractmethod
    def recorded(self, state: State) -> Record:
        """Return what a solution keeps of a state."""

    @abc.abstractmethod
    def error(self, h: float, before: State, after: State) -> float:
        """Return e of a step (`Tolerance`); zero where there is no tolerance."""

    @abc.abstractmethod
    def start_error(self) -> float:
        """Return e of a first step of size 1, estimated from the start; it goes with h^order."""
