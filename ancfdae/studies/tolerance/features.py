"""Fast features that steps may pass over without a trace: pulses of laws and of objectives.

No run can tell: a method that controls its error does not see a pulse of 2 ms between two stages of
a step of 50 ms, and two runs that both miss it agree. So everything that depends on time by itself
is sampled finely before any run: laws of loads and drives, forces and constraints of a system of
one's own, and observables with the states held.
"""

from __future__ import annotations

from collections.abc import Sequence

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


def features(system: MechanicalSystem, observables: Sequence[Observable], t_end: float) -> Pulses:
    """Sample laws and observables; one without features asks for no steps and has no stops."""
    count = SAMPLES if isinstance(system, PlannedSystem) else _CALLS
    t = np.linspace(0.0, t_end, count + 1)
    with np.errstate(all="ignore"):
        rows = [find_pulses(t, system.over_time(t), _LEAST)]
    seen = [x for x in observables if any(leaf.names_time for leaf in x.leaves())]
    if seen:
        rows.append(find_pulses(t, _held(system, seen, t), _LEAST))
    stops = sorted(set(rows[0].stops).union(*(x.stops for x in rows)))
    return Pulses(max(x.steps for x in rows), tuple(stops[:_MOST]))


def _held(system: MechanicalSystem, observables: Sequence[Observable], t: Array) -> Array:
    """Return values of observables over time at the start with the sizes of a motion added."""
    problem = InitialValueProblem.of(system, float(t[-1]))
    first, scales = problem.initial, problem.scales
    held = first.q, first.v + scales.v, first.lam + scales.lam
    q, v, lam = (np.broadcast_to(x, (len(t), len(x))) for x in held)
    states = States(t, q, v, lam)
    columns = []
    for each in observables:
        try:
            columns.append(np.real(each.value(system, states)))
        except AncfdaeError:  # The run says so with the instant.
            continue
    return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))
