"""Critical points of a parameter p: where an equilibrium loses its stiffness.

With one coordinate held (`held_coordinate.py`) equilibria are tau(a, p) = 0. At a limit point
tau = tau_a = 0. Where two paths cross, at a bifurcation, tau has a saddle of height zero:
tau = tau_a = tau_p = 0. Both are found by Newton's method in a and p, and

    limit point:  p_b = -tau_b/tau_p,      bifurcation:  [a_b, p_b] = -H^-1 [tau_ab, tau_pb]

with the Hessian H of tau in a and p. A variable with tau_b != 0 parts the paths of a bifurcation:
the load then falls as a root of the change, and has no derivative.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors import AncfdaeError, InvalidInput, require_finite, uninterrupted
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.threads import in_one_thread
from ancfdae.statics.balance import Balance
from ancfdae.statics.equilibrium import Equilibrium, find_equilibrium, resting
from ancfdae.statics.held_coordinate import HeldPoint, HeldSystem
from ancfdae.statics.softness import softest

Kind: TypeAlias = Literal["limit point", "bifurcation"]

# The range of p is searched in so many steps. The one that loses stability is halved so often until
# Newton's method starts, and again where that fails.
_STEPS, _HALVINGS, _ITERATIONS = 8, (9, 13, 17, 21), 25
# A step that needs more attempted steps of the load has met a critical point. So often that may
# prove to be wrong.
_ATTEMPTS, _ERRORS = 16, 64
# Newton's method goes on, once p changes by less than this part of the width, while changes halve;
# farther than so many widths it has left. Signs of stiffness are seen to this part of p.
_CONVERGED, _FAR, _SEEN = 1e-6, 64.0, 1e-6
# Part of what the parameter changes in tau over a motion as large as the system, below which tau,
# and its change with a variable, are none; ratio of two stiffnesses that vanish together.
_NONE, _DOUBLE = 1e-7, 1.01


@final
class NoCriticalPoint(AncfdaeError):
    """The equilibrium keeps its stiffness over the whole range, or no point could be found."""


@final
@dataclass(frozen=True)
class CriticalLoad:
    """The value of a parameter at which an equilibrium loses its stiffness.

    Attributes
    ----------
    name : str
        The parameter.
    value : float
        Its critical value.
    kind : str
        ``"limit point"``: no equilibrium near beyond it; ``"bifurcation"``: paths cross.
    motion : array, shape (n_q,)
        The motion that meets no stiffness, of the size of the system, its largest entry positive.
    equilibrium : Equilibrium
        The state there.
    names : tuple of str
        Design variables.
    gradient : array, shape (n_b,)
        Derivatives of the value with respect to them.
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

    def __repr__(self) -> str:
        """Return value, kind and derivatives."""
        lines = [f"{self.name} = {self.value:.6g}: {self.kind}"]
        lines += [f"  d/d({n}) = {g:.6g}" for n, g in zip(self.names, self.gradient, strict=True)]
        return "\n".join(lines)

    def branch(self, size: float) -> tuple[float, Equilibrium]:
        """Return an equilibrium beside this one, and the value of the parameter there.

        At a bifurcation it is on the other path; at a limit point it is farther along the path. It
        is `size` times the `motion` away, in its sense if positive. Where it is stable,
        ``equilibrium(scene.with_values({name: ...}), start=...)`` follows the path from there.

        Raises
        ------
        InvalidInput
            If the size is zero or no finite number.
        NoCriticalPoint
            If Newton's method does not converge; a smaller size may.
        """
        require_finite("size", size)
        if size == 0:
            repair = "A small part of how far the motion shall go."
            raise InvalidInput("size", "must not be zero", size, repair)
        step = size * float(self.motion[self._point.i])
        point, k = self._point, self._p
        tau_aa, tau_ab = point.in_a
        slope = tau_aa * step / 2
        bent = tau_ab[k] if self.kind == "bifurcation" else point.tau_b[k] / step
        p, q, lam = self.value - slope / bent, point.q, point.lam
        q, lam = q + step * point.motion[0], lam + step * point.motion[1]
        a, last = point.q[point.i] + step, np.inf
        for _ in range(_ITERATIONS):
            found = _held(point.system, k, p, point.i, a, q, lam)
            if found is None:
                break
            change = -found.tau / found.tau_b[k]
            if abs(change) >= 0.5 * last and last <= _CONVERGED * abs(p):
                return p, resting(found.system, found.q, found.lam, _stable(found))
            p, q, lam, last = p + change, found.q, found.lam, abs(change)
        raise NoCriticalPoint(f"branch of {self.name!r}: no convergence at size={size:g}.")


@in_one_thread
def find_critical(system: MechanicalSystem, k: int, to: float) -> CriticalLoad:
    """Search from the value of design variable k to another for the first critical point.

    NoCriticalPoint if there is none. InvalidInput if there is no stable equilibrium at the first
    value, if two motions lose their stiffness at once, or if a design variable parts the paths of a
    bifurcation.
    """
    if to == system.b[k]:
        rule, repair = "must differ from the value in the model", "Search to the other side."
        raise InvalidInput("to", rule, f"{to:g}", repair)
    start = uninterrupted(find_equilibrium(system))
    if not start.outcome.success or start.outcome.stable_to is not None:
        rule, repair = "needs a stable equilibrium to start from", "Start at another value."
        raise InvalidInput("critical_load", rule, str(start.outcome), repair)
    point, kind = _first_critical(system, k, to, start)
    motion = point.motion[0] * point.size
    motion = motion * np.sign(motion[np.argmax(np.abs(motion))])
    names = tuple(x for j, x in enumerate(system.design_names) if j != k)
    at = resting(point.system, point.q, point.lam, stable=True)
    value, gradient = float(point.system.b[k]), np.delete(_gradient(point, k, kind), k)
    return CriticalLoad(system.design_names[k], value, kind, motion, at, names, gradient, point, k)


def _stable(x: HeldPoint) -> bool:
    return softest(Balance(x.system, 0.0, x.q, x.lam), 1.0, x.q, x.lam).stable


def _moved(system: MechanicalSystem, k: int, p: float) -> MechanicalSystem:
    b = np.array(system.b)
    b[k] = p
    return system.with_values(b)


def _first_critical(
    system: MechanicalSystem, k: int, to: float, start: Equilibrium
) -> tuple[HeldPoint, Kind]:
    """Start Newton's method nearer and nearer to the loss of stability until it converges to it."""
    for p, lost, at in _losses(system, k, to, start):
        search = _Search(system, k, p, lost, at)
        found = None if search.double else search.bifurcation() or search.limit_point()
        if found is not None:
            return found
    name = system.design_names[k]
    if search.double:
        raise InvalidInput(
            "critical_load",
            "one motion must lose its stiffness, not two at once",
            f"two beyond {name} = {p:g}",
            "Hold one of them, or make their stiffness differ, as that of a square section.",
        )
    rule = f"{name!r}: stiffness is lost beyond {p:g}"
    raise NoCriticalPoint(f"{rule}, but Newton's method finds no critical point there.")


def _losses(
    system: MechanicalSystem, k: int, to: float, at: Equilibrium
) -> Iterator[tuple[float, float, Equilibrium]]:
    """Yield p before and beyond the first loss of stability, and the equilibrium before it.

    They come nearer and nearer. NoCriticalPoint if there is no loss.
    """
    p, lost, halvings, errors = float(system.b[k]), np.nan, 0, 0
    stride = (to - p) / _STEPS
    while halvings < max(_HALVINGS):
        if errors > _ERRORS:
            rule = f"{system.design_names[k]!r}: beyond {p:g} equilibria move too fast to follow."
            raise NoCriticalPoint(rule)
        if p == to:
            rule = f"{system.design_names[k]!r}: every equilibrium up to {to:g} is stable."
            raise NoCriticalPoint(rule)
        on = p + stride if abs(to - p) > 1.5 * abs(stride) else to
        ahead = on if np.isnan(lost) else (p + lost) / 2
        stable = _followed(system, k, ahead, at)
        p, lost, at = (p, ahead, at) if stable is None else (ahead, lost, stable)
        halvings += not np.isnan(lost)
        if halvings in _HALVINGS:
            # What was too far away may be stable all the same.
            stable = _followed(system, k, lost, at)
            if stable is None:
                yield p, lost, at
            else:
                p, lost, at, halvings, errors = lost, np.nan, stable, 0, errors + 1


def _followed(system: MechanicalSystem, k: int, p: float, at: Equilibrium) -> Equilibrium | None:
    """Return the equilibrium at p to which a path of stable ones leads from another; or None."""
    moved = _moved(system, k, p)
    ahead = uninterrupted(find_equilibrium(moved, start=at, near=True, max_steps=_ATTEMPTS))
    end = ahead.outcome
    return ahead if end.success and end.stable_to is None and not end.downhill else None


@final
class _Search:
    """Newton's method in a and p from the last stable equilibrium, for a point up to `lost`."""

    def __init__(
        self, system: MechanicalSystem, k: int, p: float, lost: float, at: Equilibrium
    ) -> None:
        self.p, self._k, self._lost, self._at = p, k, lost, at
        self._system = _moved(system, k, p)
        soft = softest(Balance(self._system, 0.0, at.q, at.lam), 1.0, at.q, at.lam)
        self.double = len(soft.kappa) > 1 and soft.kappa[1] < _DOUBLE * soft.kappa[0]
        self._i = int(np.argmax(np.abs(soft.motions[:, 0]) * np.sqrt(system.weights)))

    def bifurcation(self) -> tuple[HeldPoint, Kind] | None:
        """Solve tau_a = tau_p = 0; None where tau does not vanish there."""

        def equations(x: HeldPoint) -> tuple[Array, Array]:
            return _hessian(x, self._k), np.array([x.tau_a, x.tau_b[self._k]])

        point = self._newton(equations)
        if point is None or not abs(point.tau) <= _NONE * _force(point, self._k):
            return None
        return point, "bifurcation"

    def limit_point(self) -> tuple[HeldPoint, Kind] | None:
        """Solve tau = tau_a = 0; None where that leads to no limit point."""

        def equations(x: HeldPoint) -> tuple[Array, Array]:
            tau_aa, tau_ab = x.in_a
            matrix = np.array([[x.tau_a, x.tau_b[self._k]], [tau_aa, tau_ab[self._k]]])
            return matrix, np.array([x.tau, x.tau_a])

        point = self._newton(equations)
        return None if point is None else (point, "limit point")

    def _newton(self, equations: Callable[[HeldPoint], tuple[Array, Array]]) -> HeldPoint | None:
        """Return a solution between the stable place and the lost one; None if it finds none."""
        p, last, width = self.p, np.inf, abs(self._lost - self.p)
        a, q, lam = self._at.q[self._i], self._at.q, self._at.lam
        for _ in range(_ITERATIONS):
            point = _held(self._system, self._k, p, self._i, a, q, lam)
            if point is None:
                return None
            change = _solved(*equations(point), np.array([point.size, width]))
            if change is None:
                return None
            da, dp = change
            if abs(dp) >= 0.5 * last and last <= _CONVERGED * width:
                return point if self._is_between(p) else None
            a, p, last = a - da, p - dp, abs(dp)
            if not abs(p - self.p) <= _FAR * width:
                return None
            # The guess of the next solution.
            q = point.q - da * point.motion[0] - dp * point.paths[0][:, self._k]
            lam = point.lam - da * point.motion[1] - dp * point.paths[1][:, self._k]
        return None

    def _is_between(self, p: float) -> bool:
        """Whether p is where stability was lost, to the digits with which that can be seen."""
        ends, seen = sorted((self.p, self._lost)), _SEEN * abs(p)
        return ends[0] - seen <= p <= ends[1] + seen


def _held(
    system: MechanicalSystem, k: int, p: float, i: int, a: float, q: Array, lam: Array
) -> HeldPoint | None:
    moved = _moved(system, k, p)
    return HeldSystem(moved, i, q).solve(a, q, lam)


def _hessian(x: HeldPoint, k: int) -> Array:
    tau_aa, tau_ab = x.in_a
    return np.array([[tau_aa, tau_ab[k]], [tau_ab[k], x.in_p(k)[k]]])


def _force(x: HeldPoint, k: int) -> float:
    """Return what the parameter, as large as it is, changes in tau over such a motion."""
    return float(np.abs(x.in_a[1][k] * x.system.b[k]) * x.size)


def _solved(matrix: Array, right: Array, scale: Array) -> Array | None:
    """Solve for unknowns as large as a scale; None where a singular matrix has no solution."""
    scaled = matrix * scale
    rows = np.max(np.abs(scaled), axis=1)
    rows[rows == 0] = 1.0
    scaled, right = scaled / rows[:, None], right / rows
    change = np.linalg.lstsq(scaled, right)[0]
    left = np.linalg.norm(right - scaled @ change)
    return scale * change if left <= _CONVERGED * np.linalg.norm(right) else None


def _gradient(x: HeldPoint, k: int, kind: Kind) -> Array:
    """Return the derivatives of p."""
    if kind == "limit point":
        return -x.tau_b / x.tau_b[k]
    size, none = np.abs(x.system.b), _NONE * _force(x, k)
    works = np.abs(x.tau_b) > _NONE * x.reach
    parted = works & ((size == 0) | (np.abs(x.tau_b) * size > none))
    parted[k] = False
    if np.any(parted):
        name = x.system.design_names[int(np.argmax(parted))]
        raise InvalidInput(
            "critical_load",
            "a bifurcation has derivatives in variables that keep its paths crossing",
            f"{name!r}, a change of which parts them",
            "The critical load falls with a root of that change. Leave the variable out.",
        )
    return np.asarray(-np.linalg.solve(_hessian(x, k), [x.in_a[1], x.in_p(k)])[1])
