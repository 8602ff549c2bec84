"""Values of observables along a solution."""

from __future__ import annotations

import numpy as np

from ancfdae.errors import InvalidInput
from ancfdae.numerics.arrays import Array
from ancfdae.observables.observable import Observable
from ancfdae.observables.states import States
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.solution import Solution


def states_of(solution: Solution) -> States:
    """Return the states of a solution."""
    return States(solution.t, solution.q, solution.v, solution.lam, solution.degree)


def observe(
    observable: Observable, solution: Solution, system: MechanicalSystem | None = None
) -> Array:
    """Return the values of an observable along a solution, shape (n_t,).

    Parameters
    ----------
    observable : Observable
    solution : Solution
    system : MechanicalSystem, optional
        The system that was integrated; for energies, design variables and `custom` functions.

    Raises
    ------
    InvalidInput, UnknownName
        If something that the observable names does not exist, the system is missing, or the
        solution is complex and the system is not: it would hold the design variables fixed.
    """
    held = system is not None and system.n_b > 0 and not np.iscomplexobj(system.b)
    if held and np.iscomplexobj(solution.q):
        raise InvalidInput(
            "observe",
            "a complex solution needs a system at complex design values",
            "real ones",
            "Use Observable.partials for derivatives.",
        )
    names = solution if system is None else system
    observable.check(names)
    return observable.value(names, states_of(solution))
