"""Critical points of a parameter p: where an equilibrium loses its stiffness.

With one coordinate fixed at a (`held_coordinate.py`), tau(a, p) is the force that fixes it, and
equilibria are tau = 0. At a limit point tau = tau_a = 0. Where two paths cross, at a bifurcation,
tau has a saddle of height zero: tau = tau_a = tau_p = 0. Both are found by Newton's method in a and
p, and

    limit point:  p_b = -tau_b/tau_p,      bifurcation:  [a_b, p_b] = -H^-1 [tau_ab, tau_pb]

with the Hessian H of tau in a and p. A variable with tau_b != 0 separates the paths of a
bifurcation (an imperfection): the load then falls as a root of the change, and has no derivative.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_finite
from ancfdae.errors.kinds import AncfdaeError, InvalidInputError
from ancfdae.errors.outcomes import uninterrupted
from ancfdae.errors.text import PrintedTable, TableText, listed
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.threads import in_one_thread
from ancfdae.numerics.timing import progress_bar
from ancfdae.statics.balance import Balance
from ancfdae.statics.equilibrium import Equilibrium, Tangent, find_equilibrium, resting
from ancfdae.statics.held_coordinate import HeldPoint, HeldSystem, stiffness_total
from ancfdae.statics.outcome import FreeMotionError
from ancfdae.statics.softness import softest

Kind: TypeAlias = Literal["limit point", "bifurcation"]

# The range of p is searched in at least _STEPS steps, and in at most _PLACES attempts. A step is at
# most _SAFE times the distance at which the stiffness, extrapolated linearly, vanishes.
_STEPS, _PLACES, _SAFE = 8, 200, 0.7
# A step that needs more than _ATTEMPTS load steps has met a critical point. Most iterations.
_ATTEMPTS, _ITERATIONS = 16, 25
# Newton's method is tried again at _NEARER times the last distance to the loss of stiffness, and no
# more below _CLOSE times the way so far. Steps below _LEAST times the largest one are not divided
# to find further critical points.
_NEARER, _CLOSE, _LEAST = 0.4, 1e-7, 1e-3
# Once p changes by less than _CONVERGED times the distance to the loss of stiffness, Newton's
# method continues while changes halve; farther than _FAR distances it has diverged. A point is
# accepted up to _REACH distances, since slopes predict a limit point at twice its distance or less.
# Signs of stiffness are certain to _SEEN times p; changes below _DIGITS times it are round-off.
_CONVERGED, _FAR, _REACH, _SEEN, _DIGITS = 1e-6, 64.0, 1.5, 1e-6, 1e-8
# Most steps of Newton's method that are shortened because they lead out of the range of p.
_LEAVES = 3
_EPS = float(np.finfo(float).eps)
# An equilibrium belongs to the path if it misses the extrapolated state by at most _MISS times the
# step. Two states lie on one smooth path if the mean of their tangents misses their difference by
# at most _BEND times it. A failed step is tried again from a place within _AGAIN times its length.
_MISS, _BEND, _AGAIN = 0.5, 0.25, 0.25
# A receding loss of stiffness is assumed to be at most _RECEDES times as distant as predicted.
_RECEDES = 20.0
# Change of p, relative to the way, in the difference quotient of tau_p.
_SLOPE = 3e-3
_FLUTTER = (
    "Its loads turn with the motion, so that it may flutter, which takes no loss of stiffness: "
    "ask modes(scene, at=equilibrium(scene))"
)
_HIDDEN = (
    "Where beams are thinner than a millionth of their length, or stand thousands of lengths from "
    "the origin, round-off hides their stiffness: move the scene to the origin, or take thicker "
    "sections"
)
# Two losses of stiffness that differ by less than _GAP times their distance are to be distinguished
# from a nearer place; at _NEAR times the way they count as one, being closer than 1e-4 of it.
_GAP, _NEAR = 0.1, 1e-3
# Largest imaginary part of a rate, relative to it, that counts as round-off.
_REAL = 1e-6


@final
class NoCriticalPointError(AncfdaeError):
    """Raised if the equilibrium keeps its stiffness over the range, or no point is found."""


@final
@dataclass(frozen=True, repr=False)
class CriticalLoad(PrintedTable):
    """The value of a parameter at which an equilibrium loses its stiffness.

    Attributes
    ----------
    name : str
        Name of the parameter.
    value : float
        Critical value of the parameter, in its unit.
    kind : str
        ``"limit point"``: beyond it there is no equilibrium nearby; ``"bifurcation"``: paths cross.
    motion : array, shape (n_q,)
        Motion without stiffness, scaled to the size of the system, its largest entry positive; m,
        slopes dimensionless.
    equilibrium : Equilibrium
        The state at the critical point.
    names : tuple of str
        Names of the design variables.
    gradient : array, shape (n_b,)
        Derivatives of `value` with respect to the variables `names`; its unit over theirs.
    """

    name: str
    value: float
    kind: Kind
    motion: Array
    equilibrium: Equilibrium
    names: tuple[str, ...]
    gradient: Array
    _point: HeldPoint
    _p: int

    def to_dataframe(self) -> Any:
        """Return the derivatives as a table of pandas, a row for each design variable.

        The name of the parameter, its critical value and the kind are in its ``attrs``.
        """
        index = pandas().Index(self.names, name="design variable")
        table = pandas().DataFrame({"derivative": self.gradient}, index=index)
        table.attrs |= {"name": self.name, "value": self.value, "kind": self.kind}
        return table

    def _printed(self) -> TableText:
        slopes = (f"{slope:.6g}" for slope in self.gradient)
        rows = [("design variable", "derivative"), *zip(self.names, slopes, strict=True)]
        head = f"{self.name} = {self.value:.6g}: {self.kind}"
        return head, rows if self.names else [], ""

    def branch(self, size: float) -> tuple[float, Equilibrium]:
        """Return an equilibrium on a path near the critical point, and the parameter there.

        At a bifurcation it is on the second path; at a limit point it is farther along the path. It
        is `size` times the `motion` away, in its sense if positive. Where it is stable,
        ``equilibrium(scene.with_values({name: ...}), start=...)`` follows the path from there.

        Raises
        ------
        InvalidInputError
            If the size is zero or not a finite number.
        NoCriticalPointError
            If Newton's method does not converge; a smaller size may.
        """
        require_finite("size", size)
        if size == 0:
            repair = "A small part of how far the motion shall go."
            raise InvalidInputError("size", "must not be zero", size, repair)
        step = size * float(self.motion[self._point.i])
        point, k = self._point, self._p
        p, q, lam = self.value, point.q, point.lam
        q, lam = q + step * point.motion[0], lam + step * point.motion[1]
        a, last = point.q[point.i] + step, np.inf
        for _ in range(_ITERATIONS):
            found = _held(point.system, k, p, point.i, a, q, lam)
            if found is None:
                break
            change = -found.tau / found.tau_b[k]
            if abs(change) >= 0.5 * last and last <= _CONVERGED * abs(p):
                x = found.q, found.lam
                stable = softest(Balance(found.system, 0.0, *x), 1.0, *x).stable
                return p, resting(found.system, *x, stable)
            p, q, lam, last = p + change, found.q, found.lam, abs(change)
        raise NoCriticalPointError(f"branch of {self.name!r}: no convergence at size={size:g}.")


@in_one_thread
def find_critical(
    system: MechanicalSystem, k: int, to: float, progress: bool = False
) -> CriticalLoad:
    """Search from the value of design variable k to the value `to` for the first critical point.

    Raises NoCriticalPointError if there is none; InvalidInputError if there is no stable
    equilibrium at the first value, if two motions lose their stiffness at once, or if a design
    variable separates the paths of a bifurcation.
    """
    if system.controllers:
        rule = "must have no controllers with states, whose loop decides on stability"
        repair = "Follow the exponents of modes(scene, at=equilibrium(scene)) over the parameter."
        raise InvalidInputError(
            "critical_load", rule, listed(map(repr, system.controllers)), repair
        )
    if to == system.b[k]:
        rule, repair = "must differ from the value in the model", "Search to the other side."
        raise InvalidInputError("to", rule, f"{to:g}", repair)
    start = uninterrupted(find_equilibrium(system))
    if not start.outcome.success or start.outcome.stable_to is not None:
        rule, repair = "needs a stable equilibrium to start from", "Start at another value."
        raise InvalidInputError("critical_load", rule, str(start.outcome), repair)
    begin = float(system.b[k])
    with progress_bar(progress, total=abs(to - begin), desc=system.design_names[k]) as bar:
        point, kind = _first_critical(system, k, to, start, bar)
    # As large as the system, wherever it stands.
    extent = Balance(system, 0.0, system.start()[0], start.lam).extent
    motion = point.motion[0] * extent / norm(point.motion[0], system.weights)
    motion = motion * np.sign(motion[np.argmax(np.abs(motion))])
    names = tuple(x for j, x in enumerate(system.design_names) if j != k)
    at = resting(point.system, point.q, point.lam, stable=True)
    value = float(point.system.b[k])
    gradient = np.delete(_gradient(point, k, kind, (begin, to)), k)
    return CriticalLoad(system.design_names[k], value, kind, motion, at, names, gradient, point, k)


def _moved(system: MechanicalSystem, k: int, p: float) -> MechanicalSystem:
    if system.b[k] == p:
        return system
    b = np.array(system.b)
    b[k] = p
    return system.with_values(b)


def _first_critical(
    system: MechanicalSystem, k: int, to: float, start: Equilibrium, bar: Any
) -> tuple[HeldPoint, Kind]:
    """Follow stable equilibria, and start Newton's method nearer and nearer to the first loss.

    The progress bar `bar` counts the parameter of the states reached.
    """
    name, begin = system.design_names[k], float(system.b[k])
    place = _Place.of(system, k, np.sign(to - begin), start)
    path = _Path(begin, to)
    for _ in range(_PLACES):
        left = path.left(place)
        if left <= path.next_trial(place):
            path.tried = left
            near = max(_NEAR * abs(place.p - begin), place.blur)
            if place.crowded and place.ahead[0] <= min(near, abs(to - place.p)):
                raise InvalidInputError(
                    "critical_load",
                    "one motion alone must lose its stiffness, not two at once",
                    f"two motions just beyond {name} = {place.p:g}",
                    "Hold one of them by a joint, or make their stiffnesses differ: a square "
                    "section buckles both ways at one load.",
                )
            search = _Search(place, k, (begin, to), left)
            found = None if place.crowded else search.bifurcation() or search.limit_point()
            if found is not None:
                return found
        if left <= _CLOSE * max(abs(place.p - begin), _LEAST * abs(to - begin)):
            raise NoCriticalPointError(f"{name!r}: {_lost_in_words(place)}.")
        if place.p == to:
            end = f"keeps its stiffness. {_FLUTTER}" if place.follows else "is stable"
            if place.hidden:
                end = f"seems stable. {_HIDDEN}"
            raise NoCriticalPointError(f"{name!r}: every equilibrium up to {to:g} {end}.")
        last, place = place.p, path.step(system, place)
        bar.update(abs(place.p - last))
    rule = f"{name!r}: beyond {place.p:g} equilibria move too fast to follow."
    raise NoCriticalPointError(rule)


def _lost_in_words(place: _Place) -> str:
    """Describe a loss of stiffness beyond a place where Newton's method found no point."""
    if place.follows:
        return f"equilibria are unstable, or not to be followed, beyond {place.p:g}. {_FLUTTER}"
    return (
        f"stiffness is lost beyond {place.p:g}, but Newton's method finds no critical point there. "
        f"{_HIDDEN}"
    )


@final
@dataclass(frozen=True)
class _Place:
    """A stable equilibrium at parameter p, and where its stiffness is predicted to vanish.

    `ahead` are the distances in p, rising, after which motions lose their stiffness if it continues
    to change linearly, in the sense of the search; `behind` is the least distance backward, `blur`
    the round-off of the first. `motion` is the first to lose its stiffness, and `hidden` whether
    the matrix K does not see a part _GAP of it. `paths` are dq/dp and dlam/dp. `follows` is True
    if K is not symmetric.
    """

    system: MechanicalSystem
    k: int
    at: Equilibrium
    paths: tuple[Array, Array]
    follows: bool
    ahead: Array
    behind: float
    blur: float
    hidden: bool
    motion: Array

    @property
    def p(self) -> float:
        """Value of the parameter at this equilibrium, in its unit."""
        return float(self.system.b[self.k])

    @staticmethod
    def of(system: MechanicalSystem, k: int, sense: float, at: Equilibrium) -> _Place:
        """Return a place of the path; predict the stiffness of its softest motions linearly."""
        balance, state = Balance(system, 0.0, at.q, at.lam), (at.q, at.lam)
        soft = softest(balance, 1.0, *state)
        X, mu, tangent = soft.motions, soft.multipliers, Tangent(system, 0.0, *state)
        # The matrix does not see a load whose strain is below the digits of the coordinates.
        K = np.array([X.T @ tangent.exact.times(x) for x in X.T]).reshape(len(mu.T), -1).T
        unseen = K - X.T @ system.pattern.dot(soft.K, X)
        slope, paths = np.zeros_like(K), tangent.sensitivities()
        along = paths[0][:, k], paths[1][:, k]
        for j, motion in enumerate(zip(X.T, mu.T, strict=True)):
            force, side = (x[:, k] for x in stiffness_total(system, state, motion, paths))
            slope[:, j] += X.T @ force + mu.T @ side
        if not len(K):  # Constraints leave no free motion.
            nothing = np.zeros(0), np.inf, 0.0, False, np.zeros(system.n_q)
            return _Place(system, k, at, along, soft.follows, *nothing)
        if not soft.follows:
            K, slope = (K + K.T) / 2, (slope + slope.T) / 2
        rates, V = np.linalg.eig(np.linalg.solve(K, -sense * slope))
        real = np.abs(rates.imag) <= _REAL * np.abs(rates)
        v = V[:, np.argmax(np.where(real, rates.real, -np.inf))].real
        first = X @ v
        with np.errstate(divide="ignore"):
            far = 1.0 / rates[real].real
            blur = soft.noise * (v @ v) / np.abs(v @ slope @ v)
        far = far[np.isfinite(far)]
        return _Place(
            system,
            k,
            at,
            along,
            soft.follows,
            np.sort(far[far > 0]),
            float(np.min(-far[far < 0], initial=np.inf)),
            float(blur),
            bool(abs(v @ unseen @ v) > _GAP * abs(v @ K @ v)),
            first if np.any(far > 0) else X[:, 0],
        )

    @property
    def digits(self) -> float:
        """Bound of the round-off of coordinates at an equilibrium, in the norm of the weights."""
        return _DIGITS * Balance(self.system, 0.0, self.at.q, self.at.lam).extent

    def leads_to(self, q: Array, p: float) -> bool:
        """Return whether the tangent of the path leads to the state q at p, to first order."""
        ahead, way = q - self.at.q, (p - self.p) * self.paths[0]
        weights = self.system.weights
        return norm(ahead - way, weights) <= _MISS * norm(way, weights) + self.digits

    def joins(self, after: _Place, small: bool) -> bool:
        """Return whether the path from here leads to the place `after`, by their tangents.

        The mean of two tangents is the secant of a smooth path. A `small` step may have any other
        weighted mean, because the path may have a kink there, as of a cable that slackens.
        """
        step, secant = after.p - self.p, after.at.q - self.at.q
        weights, (first, last) = self.system.weights, (step * x.paths[0] for x in (self, after))
        part, turn = 0.5, last - first
        if small and np.any(turn):
            part = float(
                np.clip((weights * turn) @ (secant - first) / norm(turn, weights) ** 2, 0, 1)
            )
        missed = norm(secant - first - part * turn, weights)
        return missed <= _BEND * norm(secant, weights) + self.digits

    @property
    def crowded(self) -> bool:
        """Whether two predicted losses are too close together to be distinguished from here."""
        if len(self.ahead) < 2:
            return False
        one, other = self.ahead[:2]
        return bool(other - one <= max(_GAP * one, self.blur))


@final
class _Path:
    """Chooses steps of the parameter, from failed steps and from failures of Newton's method."""

    def __init__(self, begin: float, to: float) -> None:
        self._begin, self._to, self._sense = begin, to, np.sign(to - begin)
        self._stride = self._most = abs(to - begin) / _STEPS
        self._lost = self._failed = self.tried = np.inf
        self._rate = 1.0

    def left(self, place: _Place) -> float:
        """Return the distance in p to where stiffness is, or may be, lost; infinite if unknown."""
        return float(min([abs(self._lost - place.p), *place.ahead[:1]]))

    def next_trial(self, place: _Place) -> float:
        """Return the distance in p from which Newton's method may find the critical point."""
        near = max(abs(place.p - self._begin), self._most / _STEPS)
        return min(near, _NEARER * self.tried)

    def step(self, system: MechanicalSystem, place: _Place) -> _Place:
        """Return the next place, or the same one if it cannot be reached in one step."""
        p = self._next(place)
        step = abs(p - place.p)
        moved = _moved(system, place.k, p)
        at, way = _followed(moved, place), abs(place.p - self._begin)
        ahead = None if at is None else _Place.of(moved, place.k, self._sense, at)
        if ahead is None or not place.joins(ahead, step <= _LEAST * way):
            self._lost, self._failed, self._stride, self._rate = p, step, 0.5 * step, 1.0
            return place
        # Between two stable places stiffness may vanish and return. This is not assumed where
        # slopes have wrongly predicted the same of the path so far.
        if ahead.behind < _SAFE * step and step > _LEAST * self._most and place.behind >= way:
            self._stride = 0.5 * step
            return place
        self._stride = min(2.0 * self._stride, self._most)
        if len(place.ahead) and len(ahead.ahead):
            # Rate at which the predicted loss comes nearer.
            rate = (place.ahead[0] - ahead.ahead[0]) / step
            self._rate = float(np.clip(rate, 1.0 / _RECEDES, 1.0))
        if abs(p - self._begin) >= abs(self._lost - self._begin):
            self._lost = np.inf
        return ahead

    def _next(self, place: _Place) -> float:
        """Return the next parameter of the path: a step on, or where a step failed if near."""
        lost, room = abs(self._lost - place.p), abs(self._to - place.p)
        nearer = lost < np.inf and lost <= _AGAIN * self._failed
        if nearer and not np.any(_SAFE * place.ahead[:1] <= lost):
            return self._lost
        step = min([self._stride, _SAFE * lost, *_SAFE * place.ahead[:1] / self._rate])
        return self._to if room <= 1.1 * step else float(place.p + self._sense * step)


def _followed(moved: MechanicalSystem, place: _Place) -> Equilibrium | None:
    """Return the equilibrium at the parameters of `moved` to which a path of stable ones leads.

    Newton's method starts at the state that the tangent of `place` extrapolates to, because
    multipliers of other loads would act as a stiffness that does not exist; then at the place
    itself. None without a stable equilibrium.
    """
    at, step = place.at, float(moved.b[place.k]) - place.p
    guess = at.q + step * place.paths[0], at.lam + step * place.paths[1]
    found = _near(moved, *guess)
    if found is not None and place.leads_to(found.q, place.p + step):
        return found
    return _near(moved, at.q, at.lam)


def _near(system: MechanicalSystem, q: Array, lam: Array) -> Equilibrium | None:
    """Return a stable equilibrium near the state q, lam; None without one."""
    try:
        found = uninterrupted(
            find_equilibrium(system, start=(q, lam), near=True, max_steps=_ATTEMPTS)
        )
    except FreeMotionError:  # A critical point, to round-off.
        return None
    end = found.outcome
    return found if end.success and end.stable_to is None and not end.downhill else None


@final
class _Search:
    """Newton's method in a and p from a stable place, for a critical point just beyond it."""

    def __init__(self, place: _Place, k: int, ends: tuple[float, float], left: float) -> None:
        self._place, self._k, self._left, self._ends = place, k, left, ends
        self._size = abs(place.p - ends[0]) + left
        weights = place.system.weights
        self._i = int(np.argmax(np.abs(place.motion) * np.sqrt(weights)))

    def bifurcation(self) -> tuple[HeldPoint, Kind] | None:
        """Solve tau_a = tau_p = 0; None without convergence, or where tau is not zero there.

        tau_pp is a difference quotient at first, then follows from the changes of tau_p.
        """
        k, known = self._k, [0.0]
        last: list[HeldPoint] = []

        def equations(x: HeldPoint) -> tuple[Array, Array]:
            (tau_aa, tau_ab), before = x.in_a, last[-1] if last else None
            if before is None:
                known.append(x.bend(k, self._slope_step(x)))
            elif abs(x.system.b[k] - before.system.b[k]) > _SLOPE * self._size:
                dp, da = x.system.b[k] - before.system.b[k], x.q[x.i] - before.q[x.i]
                by_a = 0.5 * (tau_ab[k] + before.in_a[1][k]) * da
                known.append(float((x.tau_b[k] - before.tau_b[k] - by_a) / dp))
            last.append(x)
            matrix = np.array([[tau_aa, tau_ab[k]], [tau_ab[k], known[-1]]])
            return matrix, np.array([x.tau_a, x.tau_b[k]])

        point = self._newton(equations)
        if point is None or not abs(point.tau) <= point.round_off:
            return None
        if not self._place.leads_to(point.q, float(point.system.b[k])):
            return None
        return point, "bifurcation"

    def limit_point(self) -> tuple[HeldPoint, Kind] | None:
        """Solve tau = tau_a = 0; None without convergence to a point on this path.

        The point is a bifurcation where the parameter does no work on the motion, tau_p = 0.
        """
        first: list[HeldPoint] = []

        def equations(x: HeldPoint) -> tuple[Array, Array]:
            first.append(x)
            tau_aa, tau_ab = x.in_a
            matrix = np.array([[x.tau_a, x.tau_b[self._k]], [tau_aa, tau_ab[self._k]]])
            return matrix, np.array([x.tau, x.tau_a])

        point = self._newton(equations)
        if point is None or not self._ends_in(first[0], point):
            return None
        return point, "limit point" if point.parted()[self._k] else "bifurcation"

    def _ends_in(self, here: HeldPoint, end: HeldPoint) -> bool:
        """Return whether the path through `here` ends in the limit point `end`.

        Near it p(a) is a parabola and q(a) has the mean of two tangents as secant. A path beside
        this one has another slope there: zero where the parameter does no work, tau_p = 0.
        """
        k, weights, by_a = self._k, end.system.weights, end.q[end.i] - here.q[end.i]
        if not here.tau_b[k]:
            return False
        slope, dp = -here.tau_a / here.tau_b[k], end.system.b[k] - here.system.b[k]
        tangents = here.motion[0] + slope * here.paths[0][:, k] + end.motion[0]
        secant = end.q - here.q
        missed = norm(secant - 0.5 * by_a * tangents, weights)
        bends = missed <= _BEND * norm(secant, weights) + self._place.digits
        return bool(bends and abs(dp - 0.5 * by_a * slope) <= _BEND * abs(dp))

    def _slope_step(self, x: HeldPoint) -> float:
        """Return a small change of p that stays in the range."""
        begin, to = self._ends
        step, p = _SLOPE * min(self._size, abs(to - begin)), x.system.b[self._k]
        return float(np.sign(to - begin) * (step if abs(to - p) > step else -step))

    def _newton(self, equations: Callable[[HeldPoint], tuple[Array, Array]]) -> HeldPoint | None:
        """Return a solution ahead of the place and not far away; None without one."""
        place, k, last, left = self._place, self._k, np.inf, self._left
        p, a, q, lam = place.p, place.at.q[self._i], place.at.q, place.at.lam
        leaving = 0
        for _ in range(_ITERATIONS):
            point = _held(place.system, k, p, self._i, a, q, lam)
            if point is None:
                return None
            try:
                da, dp = np.linalg.solve(*equations(point))
            except np.linalg.LinAlgError:
                return None
            small = max(_CONVERGED * left, _DIGITS * self._size)
            digits = 4 * _EPS * max(abs(p), self._size)
            if (abs(dp) >= 0.5 * last and last <= small) or abs(dp) <= digits:
                return point if point.held and self._is_ahead(p) else None
            # Beyond the range the system may not exist.
            room, last = self._room(p, -dp), abs(dp)
            if not last < room:
                # A step that is shortened shows no convergence.
                part, leaving, last = 0.5 * room / last, leaving + 1, np.inf
                if not leaving <= _LEAVES:
                    return None
                da, dp = part * da, part * dp
            a, p = a - da, p - dp
            if not abs(p - place.p) <= _FAR * left:
                return None
            # The guess of the next solution.
            q = point.q - da * point.motion[0] - dp * point.paths[0][:, k]
            lam = point.lam - da * point.motion[1] - dp * point.paths[1][:, k]
        return None

    def _room(self, p: float, sense: float) -> float:
        """Return the distance from parameter p to the end of its range in the direction `sense`."""
        ends = np.array(self._ends)
        return float(np.max(ends) - p if sense > 0 else p - np.min(ends))

    def _is_ahead(self, p: float) -> bool:
        """Return whether p is in the range, and near where stability is predicted to be lost."""
        begin, to = self._ends
        sense, seen = np.sign(to - begin), _SEEN * abs(p - begin)
        beyond = sense * (p - self._place.p)
        return bool(-seen <= beyond <= _REACH * self._left + seen and sense * (to - p) >= 0)


def _held(
    system: MechanicalSystem, k: int, p: float, i: int, a: float, q: Array, lam: Array
) -> HeldPoint | None:
    moved = _moved(system, k, p)
    return HeldSystem(moved, i, q).solve(a, q, lam)


def _gradient(x: HeldPoint, k: int, kind: Kind, ends: tuple[float, float]) -> Array:
    """Return the derivatives of p, shape (n_b,), at a point reached from the first of `ends`."""
    if kind == "limit point":
        return -x.tau_b / x.tau_b[k]
    parted = x.parted()
    parted[k] = False
    if np.any(parted):
        name = x.system.design_names[int(np.argmax(parted))]
        raise InvalidInputError(
            "critical_load",
            "a bifurcation has derivatives in variables that keep its paths crossing",
            f"{name!r}, a change of which parts them",
            "The critical load falls with a root of that change. Leave the variable out.",
        )
    (tau_aa, tau_ab), tau_pb = x.in_a, x.in_p(k, *ends)
    hessian = np.array([[tau_aa, tau_ab[k]], [tau_ab[k], tau_pb[k]]])
    return np.asarray(-np.linalg.solve(hessian, [tau_ab, tau_pb])[1])
