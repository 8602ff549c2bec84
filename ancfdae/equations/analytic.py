"""Conditions for complex steps: analytic functions, and the radii up to which they are smooth."""

import warnings
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Self, final

import numpy as np

from ancfdae.equations.complex_steps import FORGOTTEN, at_values
from ancfdae.equations.motion import Motion
from ancfdae.equations.system import MechanicalSystem
from ancfdae.errors import InvalidInput
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.contour import circle_size

# Radii tried: powers of this factor around the size of the start, and around a unit of time.
_FACTOR = 4.0
_SIZES, _TIMES = range(4, -9, -1), range(15, -21, -1)
# Radii in use are this part of the best ones, for arguments move by several numbers at once.
_PART = 0.5
# Reach in a design variable, relative to its value.
_DESIGN = 0.125
# Relative difference of complex step and finite difference that is refused, the steps of these and
# their round-off against a value.
_DISAGREE = 1e-3
_STEPS, _ROUND_OFF = 10.0 ** np.arange(-3, -13, -1), 4e-16
# Distances of the trial states from the start, relative to its size: beside it, where every system
# is defined, and beyond it on both sides, where velocities have either sign.
_BESIDE, _BEYOND = 1e-2, (0.4, -0.4)


@final
@dataclass(frozen=True)
class Reach:
    """How far M, Q and Phi may be followed into the complex plane.

    Radii of q and v are norms with the weights, that of t is in s; a radius is infinite if M, Q and
    Phi do not depend on the variable.
    """

    q: float
    v: float
    t: float
    weights: Array

    @classmethod
    def of(cls, system: MechanicalSystem) -> Self:
        """Find it by trial at the start."""
        w = system.weights
        q, v = system.start()
        direction = np.cos(0.7 + 1.3 * np.arange(system.n_q)) / np.sqrt(w * system.n_q)
        sizes = [norm(x, w) or float(np.sqrt(np.max(w))) for x in (q, v)]

        def along_q(s: complex) -> Array:
            x = q + s * direction
            Q, Phi = system.force(0.0, x, v), system.constraint(0.0, x)
            return np.concatenate([Q, Phi, system.mass_times(x, direction)])

        def along_v(s: complex) -> Array:
            return system.force(0.0, q, v + s * direction)

        def along_t(s: complex) -> Array:
            return np.concatenate([system.force(s, q, v), system.constraint(s, q)])  # type: ignore[arg-type]

        return cls(
            _PART * _best(along_q, sizes[0], _SIZES),
            _PART * _best(along_v, sizes[1], _SIZES),
            _PART * _best(along_t, 1.0, _TIMES),
            w,
        )

    @property
    def coordinates(self) -> Array:
        """Reach in every coordinate, shape (n_q,)."""
        return self.q / np.sqrt(self.weights)

    def time(self, m: Motion) -> float:
        """Time for which the motion stays within reach."""
        v, a = norm(m.v, self.weights), norm(m.a, self.weights)
        limits = [self.t, _ratio(self.q, v), _ratio(self.v, a), np.sqrt(_ratio(2 * self.q, a))]
        return float(min(limits))

    def along(self, change: Motion, b: Array, db: Array, s: float) -> float:
        """Multiple of a change of state and design that stays within reach during a time s."""
        moved = db != 0
        size = np.where(b == 0, 1.0, np.abs(b))[moved]
        limits = [
            _ratio(self.q, norm(change.q, self.weights)),
            _ratio(self.v, norm(change.v, self.weights)),
            _ratio(self.q, s * norm(change.v, self.weights)),
            _ratio(self.t, abs(change.t)),
            *(_DESIGN * size / np.abs(db[moved])),
        ]
        least = float(min(limits))
        # Only a and lam change, and everything is linear in them.
        linear = max(float(np.max(np.abs(x), initial=0.0)) for x in (change.a, change.lam))
        least = least if least < np.inf else 1 / (linear or 1.0)
        # Rounded, so that the same values of b come again.
        return float(_FACTOR ** np.floor(np.log(least) / np.log(_FACTOR)))


# Kinds of systems that are being tried.
_tried: ContextVar[frozenset[type]] = ContextVar("_tried", default=frozenset())


def require_analytic(system: MechanicalSystem) -> None:
    """Evaluate M, Q, Phi and the start with complex numbers, near the start and on both sides.

    InvalidInput if one fails on complex numbers, drops an imaginary part or has another shape, or
    if `with_values` forgets the values: it then makes real systems, which would be tried in turn.
    """
    kind = type(system)
    if kind in _tried.get():
        raise InvalidInput(f"{kind.__name__}.with_values", *FORGOTTEN)
    token = _tried.set(_tried.get() | {kind})
    try:
        _require_analytic(system)
    finally:
        _tried.reset(token)


def _require_analytic(system: MechanicalSystem) -> None:
    for away in (_BESIDE, *_BEYOND):
        for name, along, shape in _probes(system, away):
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
                raise InvalidInput(where, rule, f"shape {value.shape}")
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
    n_q, n_lam, n_b = system.n_q, system.n_lam, system.n_b
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
        ("position_constraint", along(lambda x, q, v, t: x.constraint(t, q)), (n_lam,)),
    ]


def _start(system: MechanicalSystem) -> tuple[Array, Array]:
    q, v = (np.asarray(x) for x in system.start())
    if not q.shape == v.shape == (system.n_q,):
        rule = f"must return two arrays q and v of shape ({system.n_q},)"
        got = f"shapes {q.shape} and {v.shape}"
        raise InvalidInput(f"{type(system).__name__}.start", rule, got)
    return q, v


def _best(f: Callable[[complex], Array], base: float, powers: range) -> float:
    """Radius with the least round-off of a third derivative among those that are resolved."""
    best, least = base * _FACTOR ** powers[-1], np.inf
    for power in powers:
        radius = base * _FACTOR**power
        size = circle_size(f, radius)
        if size is not None and size / radius**3 < 0.5 * least:
            best, least = radius, size / radius**3
        elif least < np.inf:
            break
    return best


def _ratio(reach: float, speed: float) -> float:
    return reach / speed if speed > 0 else np.inf


def _unsafe(where: str, got: str) -> InvalidInput:
    return InvalidInput(
        where,
        "must be analytic and accept complex numbers",
        got,
        "Avoid abs, comparisons and writing into arrays of floats.",
    )
