"""Check that functions of a user are analytic, as complex steps need."""

import warnings
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from ancfdae.equations.complex_steps import at_values
from ancfdae.equations.system import MechanicalSystem
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import STEP, Array

# Relative difference of complex step and finite difference that is refused, the steps of these and
# their round-off against a value.
_DISAGREE = 1e-3
_STEPS, _ROUND_OFF = 10.0 ** np.arange(-3, -13, -1), 4e-16
# Distances of the trial states from the start, relative to its size: beside it, where every system
# is defined, and beyond it on both sides, where velocities have either sign.
_BESIDE, _BEYOND = 1e-2, (0.4, -0.4)


def require_analytic(system: MechanicalSystem, names: Collection[str]) -> None:
    """Evaluate methods of a system with complex numbers, near the start and on both sides.

    InvalidInputError if one fails on complex numbers, drops an imaginary part or has another shape.
    """
    for away in (_BESIDE, *_BEYOND):
        for name, along, shape in _probes(system, away):
            if name not in names:
                continue
            where = f"{type(system).__name__}.{name}"
            try:
                with warnings.catch_warnings(), np.errstate(all="ignore"):
                    warnings.simplefilter("error", np.exceptions.ComplexWarning)
                    value, moved = np.asarray(along(0.0)), np.asarray(along(1j * STEP))
                    refused = value.shape == shape and not _agrees(along, value, moved)
            except (TypeError, np.exceptions.ComplexWarning) as error:
                raise _unsafe(where, f"{type(error).__name__}: {error}") from error
            except (ArithmeticError, ValueError):
                if away == _BESIDE:
                    raise
                continue  # It is not defined there.
            if value.shape != shape:
                rule = f"must return an array of shape {shape}"
                raise InvalidInputError(where, rule, f"shape {value.shape}")
            if refused and (away == _BESIDE or np.all(value.imag == 0)):
                raise _unsafe(where, "a complex step that differs from the finite difference")


def _agrees(along: Callable[[complex], Array], value: Array, moved: Array) -> bool:
    """Whether the complex step is the finite difference, entry by entry.

    Of central differences that is the one whose change to the next smaller step, which is its
    error, and round-off are least.
    """
    slope = moved.imag / STEP
    # Complex numbers throughout, so that differences try the same code.
    differences = np.array(
        [np.real(np.asarray(along(complex(s))) - along(complex(-s))) / (2 * s) for s in _STEPS]
    )
    round_off = _ROUND_OFF * np.max(np.abs(value), initial=0.0) / _STEPS[1:, None]
    errors = np.abs(np.diff(differences, axis=0)) + round_off
    best = np.argmin(np.where(np.isfinite(errors), errors, np.inf), axis=0)[None]
    error, difference = (np.take_along_axis(x, best, 0)[0] for x in (errors, differences[1:]))
    gap = np.abs(difference - slope)
    agreed = (gap <= _DISAGREE * np.abs(slope) + 10 * error) | ~np.isfinite(gap)
    return bool(np.all(agreed))


def _probes(
    system: MechanicalSystem, away: float
) -> list[tuple[str, Callable[[complex], Array], tuple[int, ...]]]:
    """Names, functions of a number that moves all arguments at once, and shapes."""
    n_q, n_b = system.n_q, system.n_b
    q, v = (np.asarray(x, dtype=complex) for x in _start(system))
    # Not at the start, where velocities may be zero; no two directions alike.
    dq, dv = np.cos(np.arange(1.0, n_q + 1)), np.sin(np.arange(2.0, n_q + 2))
    dq, dv = dq * (np.max(np.abs(q)) or 1.0), dv * (np.max(np.abs(v)) or 1.0)
    b, db = system.b.astype(complex), np.where(system.b == 0, 1.0, system.b)
    db = db * np.cos(0.5 + np.arange(n_b))
    q, v = q + away * dq, v + away * dv

    def at(s: complex) -> tuple[Any, Array, Array, complex]:
        return at_values(system, b + s * db), q + s * dq, v + s * dv, 0.01 + s

    def along(value: Callable[..., Array]) -> Callable[[complex], Array]:
        return lambda s: value(*at(s))

    return [
        ("start", along(lambda x, q, v, t: np.concatenate(x.start())), (2 * n_q,)),
        ("mass_matrix", along(lambda x, q, v, t: x.mass(q)), (n_q * n_q,)),
        ("force", along(lambda x, q, v, t: x.force(t, q, v)), (n_q,)),
    ]


def _start(system: MechanicalSystem) -> tuple[Array, Array]:
    q, v = (np.asarray(x) for x in system.start())
    if not q.shape == v.shape == (system.n_q,):
        rule = f"must return two arrays q and v of shape ({system.n_q},)"
        got = f"shapes {q.shape} and {v.shape}"
        raise InvalidInputError(f"{type(system).__name__}.start", rule, got)
    return q, v


def _unsafe(where: str, got: str) -> InvalidInputError:
    return InvalidInputError(
        where,
        "must be analytic and accept complex numbers",
        got,
        "Avoid abs, comparisons and writing into arrays of floats.",
    )
