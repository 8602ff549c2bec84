"""Sharp places: where forces or integrands change within a small part of a step of a run.

Functions of time alone are sampled before any run (`features`). Functions of the state are known
only along the path of a run, and may change between any two samples: a notch of a thousandth of the
travel. But formulas are lists of operations, which bound their own values
(`ancfdae.numerics.enclosures`). Along the cubic path between two times the derivative of a function
in time lies in [low, high]. The function is then at most (high - low) h/4 away from its chord. An
interval is halved while this bound is large, or falls less than for a smooth function. No sharp
place lies between the samples that remain.

From these samples follow the distances of the function from its chords over T, T/2, T/4 and so on.
With chords of a quarter of the length a smooth function is sixteen times closer, a kink four times,
and a change within less than a chord no closer. Steps must be shorter than the longest chord from
which on the function comes closer, unless the motion itself changes as fast: then error control
resolves it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Final, NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.assembly.load_forces import LoadInput
from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import MechanicalSystem, PlannedSystem, Solution
from ancfdae.equations.formula_system import FormulaSystem
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.enclosures import Interval, enclosed, values
from ancfdae.numerics.operations import NotTraceable, Operations, Traced
from ancfdae.numerics.time_grid import LOBATTO_DEGREE
from ancfdae.sensitivity.observables.expression import Operation, evaluated, in_order
from ancfdae.sensitivity.observables.observable import Observable, States, states_of
from ancfdae.sensitivity.observables.user_functions import Custom

# Bound of the distance from a chord, over the size of the function, above which an interval is
# halved; and largest ratio of the bounds of half and whole interval of a smooth function.
_MUCH: Final = 0.05
_FALLS: Final = 1 / 3
# Least ratio of the distances from chords of a quarter of the length and of the whole, at a sharp
# place and at a kink. Least distance that counts, over the tolerance: at a sharp place, where
# derivatives contain the slope of a jump, and at a kink.
_QUARTERED, _KINKED = 0.6, 1 / 8
_JUMP, _BEND = 0.1, 0.3
# Steps per longest chord that resolves a place; number of levels by which the motion must be
# coarser, and factor by which its threshold is lower.
_FINER, _COARSER, _CLOSER = 32, 2, 2
# Least number of samples in a chord; with fewer the function is smooth there.
_SEEN: Final = 5
# Levels of the longest and the shortest chord: lengths are 2^-level of the run.
_LONGEST, _SHORTEST = 3, 30
# Largest fraction of the time in sharp places; beyond it the motion is fast throughout.
_SHARE: Final = 0.3
# Most halvings of one interval, of intervals in one pass and in all, and most operations of a list
# whose values are bounded.
_DEPTH: Final = 30
_WIDE, _MOST = 2**10, 2**15
_OPERATIONS: Final = 2000
# Number of samples of functions without a list, of functions called one by one, and most samples
# in an interval.
_SAMPLES, _CALLS, _EACH = 2**15, 2**10, 64
# Stops per longest chord that resolves a place, their largest distance over it, and most stops.
_STOPS, _APART, _ALL = 12, 0.25, 1800
# Most copies of a load that are examined, and number of times at which their forces are compared.
_COPIES, _TIMES = 4, 65
# Degree up to which polynomials of observables change no more suddenly than the observables.
_LOW: Final = 4
# Samples of the motion in each interval between the times of a path that is not dense.
_PARTS: Final = 4
# Number of stages of Radau IIA.
_STAGES: Final = 3
# Number of chords before and after a place that belong to it.
_WIDER: Final = 2


# Indices of columns of a path.
Columns: TypeAlias = "slice | list[int]"


class Part(NamedTuple):
    """Start and end of a sharp place and the longest chord that resolves it, s."""

    left: float
    right: float
    chord: float


class Places(NamedTuple):
    """Sharp places that a run passes over: number of steps that resolve all of them, and parts.

    Each part is a place that error control may not notice. Kinks have no parts; with fewer than
    `kinks` steps a run jumps over a kink that matters.
    """

    steps: int
    kinks: int
    parts: tuple[Part, ...]

    def stops(self, times: int = 1) -> tuple[float, ...]:
        """Return times, s, that divide every place, `times` as many as resolve it."""
        found = set[float]()
        for left, right, chord in self.parts:
            count = math.ceil((right - left) / chord * _STOPS) * times
            found.update(np.linspace(left, right, count + 1).tolist())
        return tuple(sorted(found)[:_ALL])

    def followed(self, stops: Sequence[float]) -> bool:
        """Return whether the stops of a run divide each place finely enough."""
        t = np.sort(stops)
        for left, right, chord in self.parts:
            inside = np.concatenate([[left], t[(t > left) & (t < right)], [right]])
            if np.diff(inside).max() > _APART * chord:
                return False
        return True

    @property
    def words(self) -> str:
        """Description of the first sharp place, for messages."""
        left, right, _ = self.parts[0]
        return (
            f"forces or observables change within {right - left:.1g} s at t = {left:.6g} s, which "
            "no run followed"
        )


class Seen(NamedTuple):
    """An observable whose sharp places matter, and the sharpness k if exp(k x) is integrated."""

    observable: Observable
    sharpness: float | None = None


class _Listed(NamedTuple):
    """Functions as a list of operations: outputs and their rates, and the path columns they need.

    `inputs` and `rates` are the numbers of these columns and of their rates in the list.
    """

    operations: Operations
    outputs: Array
    columns: list[int]
    inputs: list[int]
    rates: list[int]
    constants: dict[int, float]


class _Group(NamedTuple):
    """Functions along a path that share a size, with factors that bring them to one unit.

    If `level`, their mean is a part of the size. Functions without a list are sampled.
    """

    path: _Path
    listed: _Listed | None
    factors: Array
    level: bool
    sample: Callable[[Array, Array], Array]
    samples: int = _SAMPLES


@final
@dataclass(frozen=True)
class Witness:
    """Finds sharp places in a system and its observables that the time steps of runs pass over.

    Changes of a function far below `share`, the tolerance, do not count.
    """

    system: MechanicalSystem
    seen: tuple[Seen, ...]
    share: float

    @property
    def looks(self) -> bool:
        """Whether the system or an observable may have sharp places."""
        system = self.system
        own = not isinstance(system, PlannedSystem)
        if isinstance(system, AncfSystem):
            own = bool(system.sharp_loads())
        return own or any(_sharp(x) for x in self.seen)

    def of(self, run: Solution, steps: int) -> Places:
        """Return the sharp places of the path of a run that `steps` steps may pass over."""
        if not self.looks or len(run.t) < 3:
            return Places(0, 0, ())
        path = _Path.of(run)
        groups = [*_forces(self.system, path)]
        for each in filter(_sharp, self.seen):
            groups += _observed(self.system, each, path, run)
        found = [group.path.places(group, self.share, steps) for group in groups]
        parts = _deepest([part for each in found for part in each.parts])
        steps = max((x.steps for x in found), default=0)
        return Places(steps, max((x.kinks for x in found), default=0), parts)


def _sharp(seen: Seen) -> bool:
    """Return whether an observable may change more suddenly than the motion.

    Polynomials of a low degree, such as squares of velocities, do not.
    """
    return seen.sharpness is not None or not _degree(seen.observable) <= _LOW


def _degree(observable: Observable) -> float:
    """Return the degree of a polynomial in observables; infinite for other functions."""
    degrees = dict[object, float]()
    for node in in_order(observable):
        if not isinstance(node, Operation):
            degrees[node] = math.inf if isinstance(node, Custom) else 1.0
            continue
        of = [0.0 if isinstance(x, float) else degrees[x] for x in node.operands]
        name, last = node.function.name, node.operands[-1]
        if name in ("add", "subtract", "negative", "positive"):
            degrees[node] = max(of)
        elif name == "multiply":
            degrees[node] = sum(of)
        elif name == "square":
            degrees[node] = 2 * of[0]
        elif name == "divide" and isinstance(last, float):
            degrees[node] = of[0]
        elif name == "power" and isinstance(last, float) and last >= 0 and last % 1 == 0:
            degrees[node] = last * of[0]
        else:
            degrees[node] = math.inf
    return degrees[observable]


def _deepest(parts: Sequence[Part]) -> tuple[Part, ...]:
    """Return the parts that contain no part with a shorter chord, which would explain them."""
    found = list[Part]()
    for part in sorted(parts, key=lambda x: x.chord):
        if all(
            part.right <= x.left or x.right <= part.left or part.chord == x.chord for x in found
        ):
            found.append(part)
    return tuple(sorted(found))


@final
@dataclass(frozen=True)
class _Path:
    """Cubics through values and slopes at the times of a run: columns t, q, v, lam and more.

    The times are `dense` if there are several in each step, as in runs of high order.
    """

    t: Array
    Y: Array
    slopes: Array
    sizes: tuple[int, int]
    dense: bool = False

    @staticmethod
    def of(run: Solution) -> _Path:
        """Return the path of a run in state space, without repeated times.

        Stages of Radau IIA are less accurate than the ends of its steps: cubics through them have
        kinks. Its path has the middles of the quintics through q, v and a at the ends instead.
        """
        kept = np.append(True, np.diff(run.t) > 1e-12 * run.t[-1])
        if run.degree == _STAGES:
            kept = np.arange(len(run.t)) % _STAGES == 0
        t, q, v, a, lam = (np.real(x[kept]) for x in (run.t, run.q, run.v, run.a, run.lam))
        if run.degree == _STAGES:
            t, q, v, a, lam = _with_middles(t, q, v, a, lam)
        Y = np.concatenate([t[:, None], q, v, lam], axis=1)
        rates = np.concatenate([np.ones((len(t), 1)), v, a, np.gradient(lam, t, axis=0)], axis=1)
        return _Path(t, Y, rates, (q.shape[1], lam.shape[1]), run.degree == LOBATTO_DEGREE)

    @property
    def nodes(self) -> States:
        """The states at the times of the path."""
        t, q, v, lam = np.split(self.Y[:, : 1 + 2 * self.sizes[0] + self.sizes[1]], self._ends, 1)
        return States(t[:, 0], q, v, lam)

    @property
    def _ends(self) -> list[int]:
        return [1, 1 + self.sizes[0], 1 + 2 * self.sizes[0]]

    def with_columns(self, columns: Sequence[Array]) -> _Path:
        """Return the path with further functions, given at its times, as columns."""
        if not columns:
            return self
        more = np.stack([np.real(x) for x in columns], axis=1)
        Y = np.concatenate([self.Y, more], axis=1)
        slopes = np.concatenate([self.slopes, np.gradient(more, self.t, axis=0)], axis=1)
        return replace(self, Y=Y, slopes=slopes)

    @cached_property
    def _powers(self) -> tuple[Array, Array, Array, Array]:
        """Coefficients of 1, s, s^2 and s^3 in each interval, (columns, intervals)."""
        h, Y = np.diff(self.t), self.Y.T
        first, last, rise = h * self.slopes[:-1].T, h * self.slopes[1:].T, np.diff(Y)
        return Y[:, :-1], first, 3 * rise - 2 * first - last, first + last - 2 * rise

    def at(self, n: Array, s: Array, columns: Columns = slice(None)) -> Array:
        """Return columns at fractions s of the intervals n, shape (columns, k)."""
        y, dy, bend, twist = (x[columns][:, n] for x in self._powers)
        return np.asarray(y + s * (dy + s * (bend + s * twist)))

    def rates(self, n: Array, s: Array, columns: Columns = slice(None)) -> Array:
        """Return rates of columns at fractions s of the intervals n, shape (columns, k)."""
        _, dy, bend, twist = (x[columns][:, n] for x in self._powers)
        return np.asarray((dy + s * (2 * bend + 3 * s * twist)) / np.diff(self.t)[n])

    def boxes(
        self, n: Array, s: Array, e: Array, columns: Columns
    ) -> tuple[list[Interval], list[Interval]]:
        """Return bounds of columns and of their rates from fractions s to e of intervals n.

        A cubic and its derivative lie within the hulls of their Bezier points.
        """
        d = (e - s) * np.diff(self.t)[n]
        x, y = (self.at(n, part, columns) for part in (s, e))
        dx, dy = (self.rates(n, part, columns) for part in (s, e))
        inner, outer = x + d * dx / 3, y - d * dy / 3
        whole = [x, inner, outer, y]
        rates = [dx, 3 * (outer - inner) / d, dy]
        return (
            [Interval(*pair) for pair in zip(np.min(whole, 0), np.max(whole, 0), strict=True)],
            [Interval(*pair) for pair in zip(np.min(rates, 0), np.max(rates, 0), strict=True)],
        )

    def states(self, n: Array, s: Array) -> States:
        """Return the states of the run at fractions s of its intervals n, (k,) each."""
        (n_q, _), x = self.sizes, self.at(n, s)
        return States(x[0], x[1 : 1 + n_q].T, x[1 + n_q : 1 + 2 * n_q].T, x[1 + 2 * n_q :].T)

    def places(self, group: _Group, share: float, steps: int) -> Places:
        """Return the sharp places of a group of functions that `steps` steps may pass over."""
        with np.errstate(all="ignore"):
            if group.listed is not None:
                places = self._divided(group, group.listed, _JUMP * share)
            else:
                count = len(self.t) - 1
                each = 2 ** int(np.log2(np.clip(_SAMPLES // count, 4, _EACH)))
                samples = min(count * each, group.samples)
                places = np.linspace(0.0, count, samples + 1)
            n, parts = self._split(places)
            rows = group.sample(n, parts) * group.factors[:, None]
            known = np.all(np.isfinite(rows), axis=1)
            size = _size(rows[known], group.level)
            if not size > 0:
                return Places(0, 0, ())
            t, factors = self.at(n, parts, [0])[0], group.factors[known, None] / size

            def function(places: Array) -> Array:
                return np.asarray(group.sample(*self._split(places))[known] * factors)

            chords = _Chords.of(self.t, t, function)
            least = self._unsure()
            kinks = chords.kinks(max(_BEND * share, least))
            sharp = chords.level(max(_JUMP * share, least))
            if not (sharp.any() or kinks > steps):
                return Places(0, 0, ())
            own = self._pace(_JUMP * share / _CLOSER, t)
            return chords.places(np.where(sharp >= own + _COARSER, sharp, 0), kinks, steps)

    def _split(self, places: Array) -> tuple[Array, Array]:
        """Return intervals, and fractions of them, of positions counted in intervals."""
        n = np.minimum(places.astype(int), len(self.t) - 2)
        return n, places - n

    def _unsure(self) -> float:
        """Return the largest difference of dq/dt and v between times, over the range of v."""
        n_q, count = self.sizes[0], len(self.t) - 1
        q, v = slice(1, 1 + n_q), slice(1 + n_q, 1 + 2 * n_q)
        middles = np.arange(count), np.full(count, 0.5)
        x = self.at(*middles, v)
        off = float(np.abs(self.rates(*middles, q) - x).max(initial=0.0))
        return off / (_size(x, False) or 1.0)

    def _pace(self, share: float, t: Array) -> Array:
        """Return at times t the last level whose chords pass over a change of the motion, (k,)."""
        times = self._motion.t
        return self._motion.level(share)[np.searchsorted(times, t, side="right") - 1]

    @cached_property
    def _motion(self) -> _Chords:
        """Distances from chords of q and v, each over its largest range."""
        n_q, count = self.sizes[0], len(self.t) - 1
        both = slice(1, 1 + 2 * n_q)
        n, s = self._split(np.linspace(0.0, count, count * (1 if self.dense else _PARTS) + 1))
        q, v = (_size(x, False) or 1.0 for x in np.split(self.at(n, s, both), 2))
        factors = np.repeat([1 / q, 1 / v], n_q)[:, None]
        return _Chords.of(
            self.t, self.at(n, s, [0])[0], lambda x: self.at(*self._split(x), both) * factors
        )

    def _divided(self, group: _Group, listed: _Listed, share: float) -> Array:
        """Return the ends of intervals in which functions are smooth, (k,), as positions.

        Halves of an interval between dense times are needed only where one of them is not smooth.
        """
        count = len(self.t) - 1
        n, s, e = np.arange(count), np.zeros(count), np.ones(count)
        before, ends = np.zeros(count), [np.arange(count + 1.0)]
        outputs, rates = np.split(listed.outputs, 2)
        rows = _values(self, listed, outputs, n, s)
        low, high = rows.min(axis=1), rows.max(axis=1)
        for depth in range(_DEPTH):
            middle = (s + e) / 2
            rows = _values(self, listed, outputs, n, middle)
            if not self.dense:
                ends.append(n + middle)
            low, high = np.fmin(low, rows.min(axis=1)), np.fmax(high, rows.max(axis=1))
            both = np.stack([low, high], axis=1) * group.factors[:, None]
            size = _size(both, group.level) or 1.0
            least, most = _enclosed(self, listed, rates, n, s, e)
            d = (e - s) * np.diff(self.t)[n]
            off = (most - least) * d / 4 * group.factors[:, None] / size
            off = np.where(np.isfinite(off), off, np.inf).max(axis=0)
            again = (off > _MUCH) | ((off > share) & (off > _FALLS * before))
            if not again.any() or sum(map(len, ends)) > _MOST + 2 * count:
                break
            if again.sum() > max(_WIDE, count):
                # Only the worst intervals: of a function with unseen large values all would count.
                again &= off >= np.sort(off)[-max(_WIDE, count)]
            n, s, middle, e = (x[again] for x in (n, s, middle, e))
            if self.dense and depth:
                ends += [n + s, n + middle, n + e]
            before = np.tile(off[again], 2)
            n, s, e = np.tile(n, 2), np.append(s, middle), np.append(middle, e)
        return np.unique(np.concatenate(ends))


def _with_middles(t: Array, q: Array, v: Array, a: Array, lam: Array) -> list[Array]:
    """Return times and states of steps with the middle of every step between its ends.

    Coordinates follow the quintic through q, v and a at both ends, multipliers a cubic.
    """
    h, slopes = np.diff(t)[:, None], np.gradient(lam, t, axis=0)
    ends = [(x[:-1], x[1:]) for x in (q, v, a, lam, slopes)]
    (q0, q1), (v0, v1), (a0, a1), (lam0, lam1), (slope0, slope1) = ends
    middles = [
        (q0 + q1) / 2 + 5 * h / 32 * (v0 - v1) + h**2 / 64 * (a0 + a1),
        15 / 8 * (q1 - q0) / h - 7 / 16 * (v0 + v1) + h / 32 * (a1 - a0),
        1.5 * (v1 - v0) / h - (a0 + a1) / 4,
        (lam0 + lam1) / 2 + h / 8 * (slope0 - slope1),
    ]
    places = np.arange(1, len(t))
    rows = zip((q, v, a, lam), middles, strict=True)
    both = (np.insert(x, places, middle, axis=0) for x, middle in rows)
    return [np.insert(t, places, (t[:-1] + t[1:]) / 2), *both]


def _size(rows: Array, level: bool) -> float:
    """Return the largest range of functions (rows), or with `level` the largest value."""
    if not rows.size:
        return 0.0
    largest = float(np.abs(rows).max())
    size = largest if level else float(np.ptp(rows, axis=1).max())
    return size if size > 1e-12 * largest else 0.0


@final
@dataclass(frozen=True)
class _Chords:
    """Distances of functions of size one from chords over 2^-l of a run, at times t.

    `gaps` has a row for each level l, from `_LONGEST` on; chords of `between` begin in the middle
    of these, so that a place at the end of one chord is inside another.
    """

    t: Array
    gaps: Array
    between: Array

    @staticmethod
    def of(known: Array, t: Array, function: Callable[[Array], Array]) -> _Chords:
        """Return the distances of a function of positions from chords, down to the spacing of t.

        Positions are counted in intervals of the `known` times.
        """
        x = t / t[-1]
        at = np.interp(t, known, np.arange(float(len(known))))
        rows = function(at)

        def value(x: Array) -> Array:
            return function(np.interp(x * t[-1], known, np.arange(float(len(known)))))

        # Chords of the last level have _SEEN samples somewhere.
        few = float((x[_SEEN - 1 :] - x[: 1 - _SEEN]).min(initial=1.0))
        last = min(max(math.floor(-math.log2(few)), _LONGEST), _SHORTEST)
        gaps = np.stack([_gaps(x, rows, value, n) for n in range(_LONGEST, last + 3)], axis=1)
        return _Chords(t, *gaps)

    @cached_property
    def _cells(self) -> list[tuple[float, Array, Array, Array]]:
        """Each level, the finest last, with distances and numbers of samples of its chords.

        Distances are the largest per chord, and two levels on. Levels are counted in halves: chords
        of half levels begin between others. A chord with few samples has no distance.
        """
        found = []
        for k in range(len(self.gaps) - 2):
            for shift, rows in ((0.0, self.gaps), (0.5, self.between)):
                cell = np.floor(self.t / self.t[-1] * 2.0 ** (k + _LONGEST) + shift)
                begins = np.flatnonzero(np.append(True, np.diff(cell) > 0))
                sizes = np.diff(np.append(begins, len(cell)))
                off, after = (np.maximum.reduceat(x, begins) for x in (rows[k], self.gaps[k + 2]))
                found.append(
                    (k + _LONGEST + shift, np.where(sizes < _SEEN, 0.0, off), after, sizes)
                )
        return found

    def level(self, share: float) -> Array:
        """Return at each time the last level whose chords pass over a change, (k,); 0 for none."""
        found = np.zeros(len(self.t))
        for level, off, after, sizes in self._cells:
            over = (off > share) & (after > _QUARTERED * off)
            if over.any():
                found[np.repeat(over, sizes)] = level
        return found

    def kinks(self, share: float) -> int:
        """Return the number of steps below which steps jump over a kink of the functions."""
        last = -1.0
        for level, off, after, _ in self._cells:
            # A smooth function is closer to one chord that bends both ways, or that is cut, than
            # its curvature says; it is not to the chords beside.
            near = np.maximum(off, np.maximum(np.append(off[1:], 0.0), np.append(0.0, off[:-1])))
            if np.any((off > share) & (after > _KINKED * near)):
                last = level
        return 2 ** (math.floor(last) + 1) if last > 0 else 0

    def places(self, level: Array, kinks: int, steps: int) -> Places:
        """Return sharp places from the last level that passes over a change at each time."""
        kinks = kinks if kinks > steps else 0
        level = np.where(2.0 ** (np.floor(level) + 1) * _FINER > steps, level, 0)
        inside, t_end = level > 0, float(self.t[-1])
        if not inside.any():
            return Places(0, kinks, ())
        parts = list[Part]()
        for at in np.unique(level[inside]).tolist():
            chord, shift = t_end / 2.0 ** (math.floor(at) + 1), at % 1
            cells = np.unique(np.floor(self.t[level == at] / (2 * chord) + shift)) - shift
            for cell in cells.tolist():
                left, right = (2 * cell - _WIDER) * chord, (2 * cell + 2 + _WIDER) * chord
                parts.append(Part(max(left, 0.0), min(right, t_end), chord))
        deepest = _deepest(parts)
        if sum(part.right - part.left for part in deepest) > _SHARE * t_end:
            return Places(0, kinks, ())
        return Places(2 ** (math.floor(level.max()) + 1) * _FINER, kinks, deepest)


def _gaps(x: Array, rows: Array, value: Callable[[Array], Array], level: int) -> Array:
    """Return the largest distances of rows from chords of a level, (2, k), at shifts 0 and 1/2."""
    lefts = np.floor(x * 2.0**level + [[0.0], [0.5]]) - [[0.0], [0.5]]
    first = np.diff(lefts, axis=1, prepend=-1.0) > 0
    which = np.cumsum(first).reshape(first.shape) - 1
    # The first and the last chord may be cut.
    ends = np.clip((lefts[first] + [[0.0], [1.0]]) / 2.0**level, 0.0, 1.0)
    at_ends = value(ends.ravel()).reshape(len(rows), *ends.shape)
    left, right = at_ends[:, 0, which], at_ends[:, 1, which]
    low, high = ends[:, which]
    part = (x - low) / np.where(high > low, high - low, 1.0)
    return np.asarray(np.abs(rows[:, None] - left - part * (right - left)).max(axis=0))


# -- functions ---------------------------------------------------------------------------------


def _values(path: _Path, listed: _Listed, outputs: Array, n: Array, s: Array) -> Array:
    at = dict(zip(listed.inputs, path.at(n, s, listed.columns), strict=True))
    at |= {number: np.full(len(n), value) for number, value in listed.constants.items()}
    return values(listed.operations, outputs, at)


def _enclosed(
    path: _Path, listed: _Listed, outputs: Array, n: Array, s: Array, e: Array
) -> tuple[Array, Array]:
    whole, rates = path.boxes(n, s, e, listed.columns)
    at = dict(zip(listed.inputs, whole, strict=True)) | dict(zip(listed.rates, rates, strict=True))
    ones = np.ones(len(n))
    at |= {number: Interval(x * ones, x * ones) for number, x in listed.constants.items()}
    return enclosed(listed.operations, outputs, at)


def _with_rates(
    operations: Operations,
    outputs: Array,
    columns: tuple[Array, Array],
    constants: dict[int, float],
    path: _Path,
) -> _Group | None:
    """Return functions with their rates along a path; None for constants and very long lists.

    `columns` are the numbers of inputs and of their rates, in the order of the path.
    """
    outputs = outputs.ravel()
    if not np.any(outputs >= 0):
        return None
    pairs = list(zip(*(x.tolist() for x in columns), strict=True))
    (rates,) = operations.along(outputs, dict(pairs))
    both = np.concatenate([outputs, rates])
    used = operations.inputs(both)
    needed = [k for k, pair in enumerate(pairs) if k == 0 or not used.isdisjoint(pair)]
    inputs, rated = (list(x) for x in zip(*(pairs[k] for k in needed), strict=True))
    listed = _Listed(operations, both, needed, inputs, rated, constants)
    sample = partial(_values, path, listed, outputs)
    short = len(operations.rows(both)) <= _OPERATIONS
    return _Group(path, listed if short else None, np.ones(len(outputs)), True, sample)


def _forces(system: MechanicalSystem, path: _Path) -> list[_Group]:
    """Return forces, masses and constraints written by a user, along a path."""
    if isinstance(system, AncfSystem):
        return [group for item in system.sharp_loads() for group in _loaded(item, path)]
    if isinstance(system, PlannedSystem):
        return []
    root, groups = 1 / np.sqrt(system.weights), list[_Group]()
    listed = system.right_side() if isinstance(system, FormulaSystem) else None
    if listed is None or "Q" not in listed[1]:
        groups.append(_Group(path, None, root, True, _called(system, path), _CALLS))
    if listed is None:
        return groups
    operations, parts, at = listed
    columns = tuple(np.concatenate([at[d + x] for x in ("t", "q", "v", "lam")]) for d in ("", "d"))
    constants = dict(zip(at["b"].tolist(), np.real(system.b).tolist(), strict=True))
    for name, part in parts.items():
        group = _with_rates(operations, part, (columns[0], columns[1]), constants, path)
        if group is not None:
            groups.append(group._replace(factors=root) if name == "Q" else group)
    return groups


def _loaded(item: LoadInput, path: _Path) -> list[_Group]:
    """Return the forces of a load, with its law of time, along the path of its vectors.

    For a load in several copies only those with the largest forces are returned.
    """
    n_q, size, t = path.sizes[0], item.reference.size, path.t
    rows = path.Y[:, 1 : 1 + n_q], path.Y[:, 1 + n_q : 1 + 2 * n_q], path.slopes[:, 1 + n_q :]
    U, V, A = (item.vectors.of(x[:, :n_q]).reshape(len(t), -1, size) for x in rows)
    factors, rates = (item.factors(t, order) for order in (0, 1))
    if not np.any(factors[:, 0]):
        return []
    n_signals, n_own = factors.shape[1] - 1, item.own.shape[1]
    moving = list[_Group | None]()
    for copy in _acting(item, U, V, factors):
        own = np.repeat(item.own[[copy]].real, len(t), axis=0)
        # The law of the load stands behind its signals and own numbers.
        columns = factors[:, 1:], own, factors[:, :1]
        slopes = rates[:, 1:], 0 * own, rates[:, :1]
        Y = np.concatenate([path.Y[:, :1], U[:, copy], V[:, copy], *columns], axis=1)
        dY = np.concatenate([path.slopes[:, :1], V[:, copy], A[:, copy], *slopes], axis=1)
        n = 2 * size + n_signals + n_own
        # U, V, signals and own numbers, then their rates; the time and the law, and their rates.
        operations, at, time, factor = Operations(2 * n + 4), np.arange(n), 2 * n, 2 * n + 1
        forces = item.listed(operations, n_signals)[0].ravel().tolist()
        outputs = np.array([operations.apply(np.multiply, x, factor) for x in forces])
        both = np.array([time, *at, factor]), np.array([time + 2, *(n + at), factor + 2])
        along = _Path(t, Y, dY, (size, n_signals + n_own), path.dense)
        moving.append(_with_rates(operations, outputs, both, {}, along))
    return [group for group in moving if group is not None]


def _acting(item: LoadInput, U: Array, V: Array, factors: Array) -> list[int]:
    """Return the copies of a load with the largest forces at some times of a path."""
    count = U.shape[1]
    if count <= _COPIES:
        return list(range(count))
    some = np.unique(np.linspace(0, len(U) - 1, _TIMES).astype(int))
    F = np.zeros(count)
    for k in some:
        x, y = (row[[k]].reshape(1, -1, item.vectors.d) for row in (U, V))
        with np.errstate(all="ignore"):
            force = item.forces(x, y, factors[[k], 1:]).reshape(count, -1)
        F = np.fmax(F, np.abs(force.real).max(axis=1))
    return sorted(np.argsort(F)[-_COPIES:].tolist())


def _called(system: MechanicalSystem, path: _Path) -> Callable[[Array, Array], Array]:
    """Return forces of a system that is called for one state at a time, from few samples."""
    places = np.linspace(0.0, len(path.t) - 1.0, _CALLS + 1)
    n = np.minimum(places.astype(int), len(path.t) - 2)
    at = path.states(n, places - n)
    rows = zip(at.t.tolist(), at.q, at.v, strict=True)
    forces = np.real(np.array([system.force(*row) for row in rows]))
    return lambda n, s: np.stack([np.interp(n + s, places, x) for x in forces.T])


def _observed(system: MechanicalSystem, seen: Seen, path: _Path, run: Solution) -> list[_Group]:
    """Return an observable along a path: as a list if it can be traced, else as samples."""
    observable, k = seen
    near = 0.0
    if k is not None:
        near = float(np.max(np.real(observable.value(system, states_of(run)))))
    leaves = [x for x in observable.leaves() if not isinstance(x, Custom)]
    whole = path.with_columns([x.leaf_value(system, path.nodes) for x in leaves])
    count = whole.Y.shape[1]
    operations, at = Operations(2 * count), np.arange(2 * count)
    inputs = Traced.array(operations, at[:count])
    n_q = path.sizes[0]
    parts = np.split(inputs[: path.Y.shape[1]], [1, 1 + n_q, 1 + 2 * n_q])
    own = {leaf: inputs[path.Y.shape[1] + i :][:1] for i, leaf in enumerate(leaves)}
    t, q, v, lam = parts[0], *(x[None] for x in parts[1:])

    def value(leaf: Any) -> Array:
        if isinstance(leaf, Custom):
            return np.asarray(leaf.function(t, q, v, lam, np.real(system.b)))
        return own[leaf]

    try:
        (x,) = list(evaluated(observable, value).values())[-1]
        if k is not None:
            x = np.exp(k * (x - near))
        outputs = Traced.numbers(operations, [x])
        if operations.calls(outputs):
            raise NotTraceable("an ExternalFunction is called")
    except (NotTraceable, TypeError, ValueError, AttributeError, ArithmeticError, IndexError):
        return [_Group(path, None, np.ones(1), False, partial(_sampled, system, seen, path, near))]
    pair = at[:count], at[count:]
    group = _with_rates(operations, outputs, pair, {}, whole)
    return [] if group is None else [group._replace(level=False)]


def _sampled(
    system: MechanicalSystem, seen: Seen, path: _Path, near: float, n: Array, s: Array
) -> Array:
    """Return values of an observable, or of exp(k x), at fractions s of intervals n, (1, k)."""
    x = np.real(seen.observable.value(system, path.states(n, s)))
    return np.asarray(x if seen.sharpness is None else np.exp(seen.sharpness * (x - near)))[None]
