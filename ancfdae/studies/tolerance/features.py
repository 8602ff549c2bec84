"""Fast features that steps may pass over without a trace: pulses of laws and of objectives.

No run can tell: a method that controls its error does not see a pulse of 2 ms between two stages of
a step of 50 ms, and two runs that both miss it agree. So everything that depends on time by itself
is sampled finely before any run: laws of loads and drives, forces and constraints of a system of
one's own, and observables with the states held.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import numpy as np

from ancfdae.equations import MechanicalSystem, PlannedSystem
from ancfdae.errors.kinds import AncfdaeError
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.pulses import SAMPLES, Pulses, find_pulses
from ancfdae.sensitivity.observables.observable import Observable
from ancfdae.sensitivity.observables.states import States

# Intervals of the samples of a system that is called once an instant; laws of scenes take arrays.
_CALLS = 2**10
# Steps of the coarsest run of HHT-I3.
_LEAST = 64
# Stops of a run.
_MOST = 200


def features(
    problem: InitialValueProblem, observables: Sequence[Observable], t_end: float
) -> Pulses:
    """Sample laws and observables; one without features asks for no steps and has no stops."""
    system = problem.system
    count = SAMPLES if isinstance(system, PlannedSystem) else _CALLS
    t = np.linspace(0.0, t_end, count + 1)
    with np.errstate(all="ignore"):
        rows = [] if _timeless(system) else [find_pulses(t, system.over_time(t), _LEAST)]
    seen = [x for x in observables if any(leaf.names_time for leaf in x.leaves())]
    if seen:
        rows.append(find_pulses(t, _held(problem, seen, t), _LEAST))
    stops = sorted(set[float]().union(*(x.stops for x in rows)))
    return Pulses(max((x.steps for x in rows), default=0), tuple(stops[:_MOST]))


class _Untold:
    """A time that nobody may use: it notes that it was asked for anything, and raises TypeError."""

    def __init__(self) -> None:
        self.asked = False

    def _ask(self, *_: object) -> NoReturn:
        self.asked = True
        raise TypeError

    def __getattr__(self, name: str) -> NoReturn:
        # Arrays look for their own protocols in whatever they hold.
        if not name.startswith("__array"):
            self.asked = True
        raise AttributeError(name)

    @property  # type: ignore[misc]
    def __class__(self) -> type:
        """The class, of which a formula asks by isinstance."""
        self.asked = True
        return _Untold

    __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = __bool__ = __abs__ = _ask
    __neg__ = __pos__ = __float__ = __int__ = __complex__ = __index__ = __round__ = _ask
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __pow__ = __rpow__ = _ask
    __truediv__ = __rtruediv__ = __floordiv__ = __rfloordiv__ = __mod__ = __rmod__ = _ask
    __divmod__ = __rdivmod__ = __str__ = __format__ = _ask


def _timeless(system: MechanicalSystem) -> bool:
    """Return whether nothing in a system of equations looks at the time."""
    time = _Untold()
    try:
        values = system.over_time(np.array([time], dtype=object))
    except Exception:  # noqa: BLE001 A formula may raise anything where it meets that time.
        return False
    # A formula that catches what is raised has asked.
    return np.asarray(values).dtype != object and not time.asked


def _held(problem: InitialValueProblem, observables: Sequence[Observable], t: Array) -> Array:
    """Return values of observables over time at the start with the sizes of a motion added."""
    first, scales = problem.initial, problem.scales
    held = first.q, first.v + scales.v, first.lam + scales.lam
    q, v, lam = (np.broadcast_to(x, (len(t), len(x))) for x in held)
    states = States(t, q, v, lam)
    columns = []
    for each in observables:
        try:
            columns.append(np.real(each.value(problem.system, states)))
        except AncfdaeError:  # The run says so with the instant.
            continue
    return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))
