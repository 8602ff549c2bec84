"""What a page of code works with: a function that remembers its last run, and what was found."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult, minimize

from ancfdae.errors import UnfinishedRunError
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import stopwatch

Evaluation = Callable[[Array], tuple[Array, Array]]


@final
class Once:
    """A function that answers again without a run where it was asked before.

    SciPy asks for the objective, the constraints and the derivatives of both one after the other;
    one run answers all. The function takes x, shape (n,), and returns values, shape (m,), and their
    Jacobian, shape (m, n).
    """

    def __init__(self, function: Evaluation) -> None:
        self._function = function
        self._known: dict[bytes, tuple[Array, Array]] = {}
        self.runs = 0

    def __call__(self, x: npt.ArrayLike) -> tuple[Array, Array]:
        """Return the values and their Jacobian at x, computed once per design."""
        at = np.array(x, dtype=float)
        key = at.tobytes()
        if key not in self._known:
            self.runs += 1
            self._known[key] = self._function(at)
        return self._known[key]


@final
@dataclass(frozen=True)
class Optimisation:
    """A problem as SciPy was given it, and what it found.

    `evaluate` is as for `Once`: row 0 is the objective; the others are constraints where they have
    a limit. A run is one simulation with all its gradients; seconds are processor time of the
    optimisation; `success` is whether SciPy's own test of convergence was met.
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


def constrained(
    evaluate: Once,
    start: npt.ArrayLike,
    bounds: npt.ArrayLike,
    move: float,
    iterations: int,
    tolerance: float = 1e-7,
) -> Optimisation:
    """Minimise row 0 with every other row at most 1, by SLSQP in boxes.

    Its line search believes what the linear model promises far away, where mechanisms vibrate
    differently or runs do not finish. So it may go by `move`, half a side of a box, from where
    it stands, then on from where it ended, until it ends inside the box; a run that does not
    finish halves the box. Bounds have shape (n, 2); iterations count in all boxes together;
    SLSQP ends where the objective changes by less than the tolerance.
    """
    x, limits, clock = np.asarray(start, dtype=float), np.asarray(bounds, dtype=float), stopwatch()
    done, inside = 0, False
    while done < iterations and not inside:
        box = np.clip(np.stack([x - move, x + move], 1), limits[:, :1], limits[:, 1:])
        try:
            result = _slsqp(evaluate, x, box, iterations - done, tolerance)
        except UnfinishedRunError:
            move /= 2
            done += 1
            continue
        done += max(result.nit, 1)
        at_edge = np.isclose(result.x[:, None], box) & (box != limits)
        x, inside = result.x, bool(result.success and not np.any(at_edge))
    found = OptimizeResult(x=x, nit=done, success=inside)
    return Optimisation.of(evaluate, start, found, clock(), bounds)


def _slsqp(evaluate: Once, x: Array, box: Array, iterations: int, tolerance: float) -> Any:
    return minimize(
        lambda x: evaluate(x)[0][0],
        x,
        jac=lambda x: evaluate(x)[1][0],
        method="SLSQP",
        bounds=box,
        constraints={
            "type": "ineq",
            "fun": lambda x: 1 - evaluate(x)[0][1:],
            "jac": lambda x: -evaluate(x)[1][1:],
        },
        options={"maxiter": iterations, "ftol": tolerance},
    )


def searched(
    evaluate: Evaluation,
    start: npt.ArrayLike,
    radius: float,
    runs: int,
    bounds: npt.ArrayLike | None = None,
) -> Optimisation:
    """Minimise row 0 with every other row at most 1 by COBYQA, which asks for no derivatives.

    The trust region has the given radius at first; the search ends at a thousandth of it, or at the
    largest number of runs. Bounds have shape (n, 2).
    """
    once, clock = Once(evaluate), stopwatch()
    rows = len(once(start)[0])
    limit = {"type": "ineq", "fun": lambda x: 1 - once(x)[0][1:]}
    result = minimize(
        lambda x: once(x)[0][0],
        np.asarray(start, dtype=float),
        method="COBYQA",
        bounds=bounds,
        constraints=[limit] if rows > 1 else [],
        options={
            "maxfev": runs,
            "initial_tr_radius": radius,
            "final_tr_radius": 1e-3 * radius,
            "feasibility_tol": 1e-4,
        },
    )
    return Optimisation.of(once, start, result, clock(), bounds)
