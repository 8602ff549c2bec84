"""Taylor test: the remainder of a first-order expansion must shrink with the square."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors import InvalidInput, require_kind
from ancfdae.integrators import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.solution import Solution
from ancfdae.sensitivity.method import Method, finished


@final
@dataclass(frozen=True)
class TaylorTest:
    """Remainders of zeroth and first order along one direction of the design space.

    Attributes
    ----------
    sizes : array, shape (n,)
        Relative perturbations.
    zeroth : array, shape (n,)
        Norm over time of F(b + s db) - F(b).
    first : array, shape (n,)
        Norm over time of F(b + s db) - F(b) - s F_b db.
    order : float
        Smallest observed order of `first` between neighbouring sizes; 2 when F_b is right.
    """

    sizes: Array
    zeroth: Array
    first: Array
    order: float


def taylor_test(
    system: MechanicalSystem,
    t_end: float,
    integrator: Integrator,
    method: Method,
    observable: Callable[[Solution], Array],
    direction: Sequence[float] | None = None,
    sizes: Sequence[float] = (1e-3, 5e-4, 2.5e-4),
) -> TaylorTest:
    """Check the derivative of an observable by repeated runs.

    Parameters
    ----------
    system : MechanicalSystem
        For a scene: ``assemble(scene, design)``.
    t_end : float
    integrator : Integrator
    method : Method
        The method under test.
    observable : callable
        As in `Solution.derivative`.
    direction : sequence of float, optional
        Relative change of each design variable (absolute where it is zero); ones by default.
    sizes : sequence of float
        Perturbation sizes, falling. Too small ones meet round-off instead of curvature.

    Raises
    ------
    InvalidInput
        If sizes or direction make no sense.
    UnfinishedRun
        If a run ends early.
    """
    require_kind("system", system, (MechanicalSystem,), "Use assemble(scene, design).")
    require_kind("method", method, (Method,), "For example Direct().")
    if len(sizes) < 2 or np.any(np.diff(sizes) >= 0) or min(sizes) <= 0:
        raise InvalidInput(
            "sizes", "must be two or more, positive and falling", sizes, "Use 1e-3, 5e-4."
        )
    relative = np.ones(system.n_b) if direction is None else np.asarray(direction, dtype=float)
    if relative.shape != (system.n_b,):
        raise InvalidInput(
            "direction", f"must have {system.n_b} entries", relative.shape, "One per variable."
        )
    db = relative * np.where(system.b == 0, 1.0, np.abs(system.b))
    base = finished(method.differentiate(system, t_end, integrator, False))
    integrator = integrator.frozen(base)
    value = np.asarray(observable(base))
    slope = base.derivative(observable) @ db
    zeroth, first = [], []
    for size in sizes:
        moved = finished(integrator.integrate(system.with_values(system.b + size * db), t_end))
        change = np.asarray(observable(moved)) - value
        zeroth.append(float(np.linalg.norm(change)))
        first.append(float(np.linalg.norm(change - size * slope)))
    scale = np.asarray(sizes, dtype=float)
    orders = np.diff(np.log(first)) / np.diff(np.log(scale))
    return TaylorTest(scale, np.array(zeroth), np.array(first), float(np.min(orders)))
