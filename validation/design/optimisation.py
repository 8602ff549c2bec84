"""What a page of code works with: a function that remembers its last run, and what was found."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import numpy.typing as npt

__all__ = ["Array", "Evaluation", "Once", "Optimisation", "stopwatch"]

Array = npt.NDArray[np.float64]
Evaluation = Callable[[Array], tuple[Array, Array]]


@final
class Once:
    """A function that answers again without a run where it is asked at the same place.

    SciPy asks for the objective, the constraints and the derivatives of both one after the other;
    one run answers all.

    Parameters
    ----------
    function : callable
        Takes x, shape (n,); returns values, shape (m,), and their Jacobian, shape (m, n).
    """

    def __init__(self, function: Evaluation) -> None:
        self._function = function
        self._last: tuple[Array, tuple[Array, Array]] | None = None
        self.runs = 0

    def __call__(self, x: npt.ArrayLike) -> tuple[Array, Array]:
        """Return values and Jacobian."""
        at = np.array(x, dtype=float)
        if self._last is None or not np.array_equal(at, self._last[0]):
            self._last = at, self._function(at)
            self.runs += 1
        return self._last[1]


@final
@dataclass(frozen=True)
class Optimisation:
    """What SciPy was given and what it found.

    Attributes
    ----------
    evaluate : callable
        As for `Once`. Row 0 is the objective; the others are constraints where they have a limit.
    start, optimum : array, shape (n,)
    iterations, runs : int
        A run is one simulation with the gradients of everything asked for.
    seconds : float
        Processor time of the optimisation.
    success : bool
        Whether SciPy's own test of convergence was met.
    bounds : array, shape (n, 2), or None
    """

    evaluate: Evaluation
    start: Array
    optimum: Array
    iterations: int
    runs: int
    seconds: float
    success: bool
    bounds: Array | None = None

    @classmethod
    def of(
        cls,
        once: Once,
        start: npt.ArrayLike,
        result: Any,
        seconds: float,
        bounds: npt.ArrayLike | None = None,
    ) -> "Optimisation":
        """Take over what SciPy returned; solvers without iterations count evaluations."""
        return cls(
            once,
            np.asarray(start, dtype=float),
            np.asarray(result.x, dtype=float),
            int(result.get("nit", result.get("nfev"))),
            once.runs,
            seconds,
            bool(result.success),
            None if bounds is None else np.asarray(bounds, dtype=float),
        )


def stopwatch() -> Callable[[], float]:
    """Return a function that tells the processor time since now; s."""
    begin = time.process_time()
    return lambda: time.process_time() - begin
