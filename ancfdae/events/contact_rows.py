"""Contacts in one state: rows of gaps and sliding velocities, restitution, and friction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.complex_steps import at_values
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.events.functions import (
    Partials,
    RowsOf,
    gap_rows,
    partials,
    rows_along,
    sliding_rows,
)
from ancfdae.events.kinds import Impact
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import Observable, States


def rows_of_contacts(impacts: Sequence[Impact]) -> list[RowsOf]:
    """Return functions of the rows of `contact_rows`: gaps first, then sliding velocities."""

    def of_gap(gap: Observable) -> RowsOf:
        return lambda system, t, q: gap_rows(system, gap, t, q)

    def of_sliding(sliding: Observable) -> RowsOf:
        return lambda system, t, q: sliding_rows(system, sliding, t, q)

    rough = [of_sliding(line) for x in impacts for line in x.lines]
    return [*(of_gap(x.gap) for x in impacts), *rough]


def contact_rows(
    system: MechanicalSystem,
    impacts: Sequence[Impact],
    t: complex,
    q: Array,
    *,
    smooth: bool = False,
) -> tuple[Array, Array]:
    """Return rows W of gaps and sliding velocities, (m + k, n_q), and rates at v = 0, (m + k,).

    States and designs may have small imaginary parts. If `smooth`, rows of sliding velocities are
    left out.
    """
    real = system
    if np.iscomplexobj(system.b):
        real = at_values(system, system.b.real)
    time, functions = (
        float(np.real(t)),
        rows_of_contacts(impacts)[: len(impacts) if smooth else None],
    )
    pairs = [rows_of(real, np.array([time]), q.real[None]) for rows_of in functions]
    W, w_t = np.array([x[0] for x, _ in pairs]), np.array([x[0] for _, x in pairs])
    if not (np.iscomplexobj(q) or np.iscomplexobj(system.b) or np.iscomplexobj(t)):
        return W, w_t
    along = np.array([np.imag(t)]), np.imag(q)[:, None], np.imag(system.b)[:, None]
    turned = [rows_along(real, rows_of, time, q.real, along) for rows_of in functions]
    W = W + 1j * np.array([x[:, 0] for x, _ in turned])
    return W, w_t + 1j * np.array([x[0] for _, x in turned])


def coefficient(
    system: MechanicalSystem,
    e: float | Observable,
    what: str,
    state: tuple[complex, Array, Array],
) -> complex:
    """Return the restitution or friction of an impact; raise InvalidInputError if negative."""
    if not isinstance(e, Observable):
        return e
    t, q, v = state
    at = States(np.array([t]), q[None], v[None], np.zeros((1, system.n_lam)))
    value = complex(e.value(system, at)[0])
    if not value.real >= 0:
        where = f"Impact.{what} at t = {np.real(t):.6g}"
        raise InvalidInputError(where, "must not be negative", value.real)
    return value if np.iscomplexobj(q) or np.iscomplexobj(system.b) else value.real


def gap_partials(
    system: MechanicalSystem, impact: Impact, state: tuple[float, Array, Array]
) -> Partials:
    """Return the partials of the gap of an impact at a real state."""
    return of_state(system, impact.gap, state)[1]


def of_state(
    system: MechanicalSystem, function: Observable, state: tuple[complex, Array, Array]
) -> tuple[float, Partials]:
    """Return value and partial derivatives of an observable at a state (t, q, v), with real t."""
    t, q, v = state
    at = States(np.array([np.real(t)]), q[None], v[None], np.zeros((1, system.n_lam)))
    return partials(system, function, at)
