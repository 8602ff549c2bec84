"""Whether steps end at the motion that drivers prescribe (docs/theory/03-joints-and-loads.md).

Constraints have several solutions, and a long step can end at another one than the motion leads to.
The equation of a prescribed angle holds half a turn off as well: its root is checked at the start
(`AssembledStart` of the assembly), and here after every step. Joints may also close in another way
(the crossed four-bar), or lock on the way: steps of prescribed motions that change Phi_q much are
followed (`branch`). Coordinates that the constraints determine alone, as of a driven linkage with a
pendulum at its slider, are followed without the free ones, which could lead them past a singular
position. They are followed also in steps in which their velocities change much: joints that lock
and open again within a step leave Phi_q as it was.

Mass matrices that depend on q may lose their definiteness on the way (`indefinite`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.saddle_points import OPENED
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.branch import (
    APART,
    CHANGED,
    Form,
    Place,
    closed,
    followed,
    small,
    to_singular,
)
from ancfdae.integrators.poles import passed_pole
from ancfdae.integrators.recorder import Rows, SolutionRecorder
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array

# Largest rotation in a step under error control, rad: a longer step does not resolve a circle, and
# the wrong root, half a turn off, is still three such steps away.
_TURN = 1.0
# Times in a step, as fractions of it, at which the rate of the angle is evaluated.
_PLACES = np.linspace(0.0, 1.0, 5)
# A motion that constraints determine is followed if a step changes velocities by more than
# _VELOCITIES times the sum of their norms before and after it: a rotation by 0.2 rad.
_VELOCITIES = 0.1
# States that are checked in one batch: one by one the checks would cost a quarter of a small step.
_TOGETHER = 64
_TURNS = (
    " A law that turns back just before this position does not lock: round-off hides the way "
    "there, and shorter steps may pass."
)
_LIGHTER = (
    "At the end of the next step, t = {:.6g}, it is negative in a direction that the constraints "
    "permit. The motion ends before that, because accelerations are infinite where it is singular. "
    "Choose a smaller t_end, or check mass_matrix."
)
# Least and largest number of states whose Phi_q is compared with one reference state in one batch;
# in between, twice as many as were near the last reference.
_ROWS, _MOST_ROWS = 4, 128
# Largest distance of the middle of a step from where its joints close, over the length of the step.
_OPEN = 1e-3
# Least number of states of a run that are searched for singular positions, and largest stride.
_FEW, _MOST_STRIDE = 64, 16
# Number of entries of matrices n_lam x n_lam whose arithmetic costs as much as the calls for it.
_NUMBERS = 10_000


class Lost(NamedTuple):
    """The first recorded state that a step reached wrongly, the verdict, and a remedy in words."""

    first: int
    verdict: Verdict
    remedy: str


@final
class Changes:
    """Finds the steps of a motion that change Phi_q by more than a branch of constraints allows."""

    def __init__(self, system: MechanicalSystem) -> None:
        self._system = system
        self._form: Form | None = None
        self._place: Place | None = None
        # In a small system the first reference state is compared with as large a batch as any.
        self._count = min(max(_ROWS, _NUMBERS // max(system.n_lam, 1) ** 2), _MOST_ROWS)

    def between(self, rows: Rows) -> Array:
        """Return which steps change Phi_q by more than CHANGED, shape (k,).

        Twice that change may lead to another branch of the constraints.
        """
        values = self._system.constraints_q(rows.t, rows.q)
        form = self._form = self._form or Form(self._system, values[0])
        changed, k, at = np.zeros(len(rows.t) - 1, dtype=bool), 0, -1
        while k < len(changed):
            if self._place is None:
                self._place, at = Place(form, values[k]), k
            far = self._place.changes(values[k + 1 : k + 1 + self._count]) > CHANGED
            near = int(np.argmax(far)) if np.any(far) else len(far)
            k, self._count = k + near, min(max(_ROWS, 2 * near), _MOST_ROWS)
            if near == len(far):
                continue
            if at == k:  # This one step changes it.
                changed[k] = True
                k += 1
            self._place = None
        return changed


class TriedOver(Exception):
    """A step was tried over pairs that a system leaves out: its states q, (k, n_q), and advice."""

    def __init__(self, q: Array, advice: str) -> None:
        super().__init__(advice)
        self.q, self.advice = q, advice


@final
class Watch:
    """Checks recorded states of a run, each once, and cuts the run back to its last right state."""

    def __init__(
        self, system: MechanicalSystem, recorder: SolutionRecorder, weighed: bool = False
    ) -> None:
        """Check the states of a recorder; those that are `weighed` are known to have mass."""
        self._system, self._recorder = system, recorder
        self._right = max(recorder.instants, 1)
        self._linear = system.traits.linear_constraints or not system.n_lam
        # Whether the motion is known to be prescribed: other motions are not followed.
        self._driven = system.n_lam == system.n_q
        self._routed = system.traits.routed
        self._left_out = system.left_out() if system.traits.leaves_out else ()
        self._inert = weighed or system.traits.constant_mass
        self._changes: Changes | None = None

    def missed(self, all_of_them: bool = False) -> Lost | None:
        """Check new states, in batches or all of them; return the first wrong step, or None.

        The recorder then deletes that step and all after it.
        """
        recorder = self._recorder
        if recorder.instants < self._right:  # Steps were taken back.
            self._right = recorder.instants
            self._left_out = self._system.left_out()
        late = recorder.instants - self._right
        together = 1 if self._left_out or all_of_them else _TOGETHER
        if late < together:
            return None
        # A diverged state overflows and counts as lying on no branch.
        with np.errstate(all="ignore"):
            lost = self._lost(recorder.last(late + 1))
        if lost is not None:
            recorder.cut(self._right + lost.first)
        self._right = recorder.instants
        return lost

    @property
    def tries(self) -> Callable[[Rows], None] | None:
        """Function that raises TriedOver if a tried step meets pairs left out; None without."""
        return self._try if self._left_out else None

    def _try(self, rows: Rows) -> None:
        path = [np.concatenate(x).real for x in zip(self._recorder.last(1), rows, strict=True)]
        for pairs in self._left_out:
            if found := pairs.tried(*path):
                q, missed = found
                raise TriedOver(np.concatenate([path[1], q]), missed.advice)

    def _lost(self, rows: Rows) -> Lost | None:
        """Return the first wrong step between `rows`; its `first` counts from the second row.

        None if right.
        """
        for pairs in self._left_out:
            pairs.follow(rows.t, rows.q.real, rows.v.real)
            if missed := pairs.missed():
                first = max(int(np.searchsorted(rows.t, missed.time)) - 1, 0)
                return Lost(first, Verdict.LEFT_OUT, missed.advice)
        gone, verdict = self._system.mirrored(rows.q), Verdict.FOLDED
        if self._routed:
            off = self._system.off_route(*(x if gone is None else x[: gone[0]] for x in rows))
            gone, verdict = (gone, verdict) if off is None else (off, Verdict.OFF_ROUTE)
        if gone is not None:
            first, what = gone
            rows = Rows(*(x[:first] for x in rows))
        over = passed_pole(self._system, rows) if self._system.divides else None
        if over is not None:
            return Lost(over[0], Verdict.POLE, over[1])
        if self._system.traits.rows_left_out:
            opened = self._system.opened(rows.t[1:], rows.q[1:])
            if opened is not None:
                words = f"At the end of the next step stands {opened[1]}. {OPENED}"
                return Lost(opened[0], Verdict.OPENED, words)
        lighter = None if self._inert else lost_mass(self._system, rows)
        if lighter is not None:
            return lighter
        t, q, _ = rows
        found = self._system.off_root(t[1:], q[1:])
        end = len(t) - 1 if found is None else found[0]
        # Linear constraints have one solution, or none.
        several = not self._linear and len(t) > 1 and not np.iscomplexobj(q)
        elsewhere = self._elsewhere(Rows(*(x[: end + 1] for x in rows))) if several else None
        if elsewhere is not None:
            return elsewhere
        if found is not None:
            words = _half_a_turn(self._system, found[1], *t[end : end + 2].tolist())
            return Lost(end, Verdict.OFF_ROOT, words)
        if gone is not None:
            return Lost(first - 1, verdict, f"The next step {what}.")
        return None

    def _elsewhere(self, rows: Rows) -> Lost | None:
        """Return the first step that ended on another branch or passed over a lock, or None."""
        some = rows.t[[0, len(rows.t) // 2, -1]]
        self._driven = self._driven or is_driven(self._system, some, rows.q[0])
        if not self._driven:
            return None
        part = self._system.constraint_pattern.determined
        self._changes = self._changes or Changes(self._system)
        suspects = self._changes.between(rows) | _turned(self._system, rows, part[1])
        for k in np.flatnonzero(suspects):
            step = Rows(*(x[k : k + 2] for x in rows))
            why = _reached_otherwise(self._system, step, *part)
            if why:
                return Lost(int(k), Verdict.OFF_ROOT, why)
        return None


def singular_position(system: MechanicalSystem, rows: Rows) -> float | None:
    """Return the first time (s) between `rows` at which Phi_q loses rank; None if it does not.

    A step that changes Phi_q much is followed along the cubic through its ends; following ends
    early only where parts of 1e-9 of the step still change Phi_q by more than itself. In long runs
    the search begins with every 16th row: a rank that is lost between two of these rotates a row of
    Phi_q.
    """
    last = len(rows.t) - 1
    stride = min(max(last // _FEW, 1), _MOST_STRIDE)
    some = np.append(np.arange(0, last, stride), last)
    changes = Changes(system)
    with np.errstate(all="ignore"):
        for first in range(0, len(some) - 1, _MOST_ROWS):
            block = some[first : first + _MOST_ROWS + 1]
            for k in np.flatnonzero(changes.between(Rows(*(x[block] for x in rows)))):
                within = Rows(*(x[block[k] : block[k + 1] + 1] for x in rows))
                time = _singular_within(system, within)
                if time is not None:
                    return time
    return None


def _singular_within(system: MechanicalSystem, rows: Rows) -> float | None:
    """Return the first time (s) at which Phi_q loses rank between `rows`, checking every step."""
    for k in np.flatnonzero(Changes(system).between(rows)):
        step = Rows(*(x[k : k + 2] for x in rows))
        t, end = step.t.tolist()
        begin = closed(system, t, step.q[0], None)
        reached = t if begin is None else to_singular(system, t, begin, end, step.cubic)[0]
        if reached < end and _leads(system, step):
            return reached
    return None


def _leads(system: MechanicalSystem, step: Rows) -> bool:
    """Return whether the cubic through the ends of a step closes the joints in its middle.

    If output times are too far apart, the cubic is not the way of the motion between them.
    """
    (t, end), w = step.t.tolist(), system.weights
    middle = step.cubic((t + end) / 2)
    found = closed(system, (t + end) / 2, middle, None)
    return found is not None and norm(found - middle, w) <= _OPEN * norm(
        np.diff(step.q, axis=0)[0], w
    )


def nearest_to_singular(system: MechanicalSystem, rows: Rows) -> tuple[float, float]:
    """Return the time (s) at which Phi_q is nearest to losing rank, and the growth of errors there.

    Nearness is the smallest singular value of Phi_q W^(-1/2) with rows of length one, W the weights
    of the coordinates. The largest such value of a run over the smallest one is the factor by which
    errors grow along the constraints there. It is taken at some states, evenly spaced and at the
    ends of the steps that turn the velocity most. Coordinates that constraints determine alone have
    no growing errors and are left out; the factor is one if these are all.
    """
    taken, known = system.constraint_pattern.determined
    if np.all(taken):
        return float(rows.t[0]), 1.0
    w, pattern = np.sqrt(system.weights), system.constraint_pattern
    v = rows.v * w
    sizes, least = np.linalg.norm(v, axis=1), np.finfo(float).tiny
    turns = np.linalg.norm(np.diff(v, axis=0), axis=1) / (sizes[1:] + sizes[:-1] + least)
    sharpest = np.argsort(turns)[-_FEW:]
    even = np.linspace(0, len(rows.t) - 1, _FEW).astype(int)
    some = np.unique(np.concatenate([even, sharpest, sharpest + 1]))
    scaled = np.zeros((len(some), *pattern.shape))
    values = system.constraints_q(rows.t[some], rows.q[some])
    scaled[:, pattern.rows, pattern.columns] = values / w[pattern.columns]
    scaled = scaled[:, ~taken][:, :, ~known]
    scaled /= np.linalg.norm(scaled, axis=2, keepdims=True)
    nearness = np.linalg.svd(scaled, compute_uv=False)[:, -1]
    nearest = int(np.argmin(nearness))
    return float(rows.t[some[nearest]]), float(np.max(nearness) / max(nearness[nearest], least))


def half_a_turn_off(system: MechanicalSystem, begin: float, t: Array, q: Array) -> str:
    """Return a message if a step from `begin` (s) to the states q at times t left a driver's root.

    It is empty if every driver is on the root that its law leads to.
    """
    found = system.off_root(t, q)
    if found is None:
        return ""
    first, joint = found
    return _half_a_turn(
        system, joint, begin if first == 0 else float(t[first - 1]), float(t[first])
    )


def is_driven(system: MechanicalSystem, t: Array, q: Array) -> bool:
    """Return whether constraints at fixed q change from the first of the times t to others."""
    if system.scleronomic:
        return False
    first, *others = t.tolist()
    at_rest = system.constraint(first, q)
    return any(np.any(system.constraint(later, q) != at_rest) for later in others)


def _reached_otherwise(system: MechanicalSystem, step: Rows, taken: Array, known: Array) -> str:
    """Follow a step on its branch; return a message if the step ended elsewhere, else "".

    The constraints in the mask `taken` determine the coordinates in the mask `known`. Far from the
    origin last places of coordinates hide the way near a dead point, unless they may be magnified;
    if they may, they hide which branch is which where branches cross. One way that leads to the end
    of the step is enough.
    """
    why = _not_led_to(system, step, taken, known, True)
    return why and _not_led_to(system, step, taken, known, False) and why


def _not_led_to(
    system: MechanicalSystem, step: Rows, taken: Array, known: Array, magnified: bool
) -> str:
    """Return a message as `_reached_otherwise`, with round-off `magnified` as in `Form` or not."""
    begin, end = step.t.tolist()
    several = (
        f"At t = {end:.6g} the joints close in more than one way, and the step of "
        f"{end - begin:.2g} s is too long to tell which way the motion leads to, or its tolerance "
        "leaves the joints open too far. Take shorter steps, or a smaller rtol."
    )
    for rows, columns in ((taken, known), (np.ones_like(taken), np.ones_like(known))):
        prescribed = rows is taken
        if prescribed and not np.any(known):
            continue
        # IDA leaves constraints open by its tolerance.
        q, found = (
            closed(system, t, x, rows, magnified) for t, x in zip((begin, end), step.q, strict=True)
        )
        if q is None or found is None:
            return several if prescribed else ""
        guide = None if prescribed else Rows(step.t, np.stack([q, found]), step.v).cubic
        reached, place = followed(system, begin, q, end, guide, rows, magnified)
        if reached < end:
            # A motion with free directions may pass singular positions, where branches meet.
            passed = f"{locks(reached)} The step to t = {end:.6g} passed over it."
            back = float(system.weights @ (step.v[0] * step.v[1])) < 0
            return passed + back * _TURNS if prescribed else ""
        w, least = system.weights[columns], 10 * small(system, q)
        if norm((place - found)[columns], w) > max(APART * norm((found - q)[columns], w), least):
            return several
        if np.all(known):
            break
    return ""


def _turned(system: MechanicalSystem, rows: Rows, known: Array) -> Array:
    """Return in which steps, (k,), velocities of the coordinates in mask `known` change much."""
    weighted = np.sqrt(system.weights[known]) * rows.v[:, known]
    sizes = np.linalg.norm(weighted, axis=1)
    changes = np.linalg.norm(np.diff(weighted, axis=0), axis=1)
    return np.asarray(changes > _VELOCITIES * (sizes[1:] + sizes[:-1]))


_MISSING = (
    "Equations of joints are left out (Scene.left_out): those that stay may depend on each other "
    "near this position, where the mechanism itself is regular. Declare one of these joints as a "
    "stiff Bushing instead."
)


def locks(t: float) -> str:
    """Return the sentence that the joints lock at time t, s."""
    return (
        f"The joints lock at t = {t:.6g}: they cannot be closed at the positions that their laws "
        "prescribe beyond it, whatever the step. Change a length or a law."
    )


def lock(system: MechanicalSystem, t: float, q: Array, end: float) -> str:
    """Return a message if the joints lock right after time t, s, or may lack equations there.

    It is empty if they do not.
    """
    missing = _MISSING if system.traits.rows_left_out else ""
    if np.iscomplexobj(q) or not end > t:
        return missing
    taken, known = system.constraint_pattern.determined
    if not np.any(known):
        return missing
    reached, _ = followed(system, t, q, end, taken=taken)
    return locks(reached) if reached < end else missing


def turn_error(system: MechanicalSystem, t: float, h: float, order: int) -> float:
    """Return (angle / 1 rad)^order for the largest prescribed rotation in a step of h (s) to t."""
    rate = float(np.max(system.turn_rate(t - h + h * _PLACES)))
    return (rate * h / _TURN) ** order


def _half_a_turn(system: MechanicalSystem, joint: str, begin: float, end: float) -> str:
    rate = float(np.max(system.turn_rate(begin + (end - begin) * _PLACES)))
    turns = f", which turns at {rate:.3g} rad/s," if rate > 0 else ""
    repair = f"{_TURN / rate:.2g} s or less" if rate > 0 else "a fraction of this size"
    return (
        f"Joint {joint!r}{turns} stands half a turn from the angle of its law at t = {end:.6g}: "
        f"its equation holds there as well. Take steps of {repair}, or rtol."
    )


# Eigenvalue of M, scaled to a diagonal of one, below which M is negative in a direction, over the
# largest one.
_NEGATIVE = -1e-10
# Most entries of matrices that are examined together.
_ENTRIES = 2**20


def lost_mass(system: MechanicalSystem, rows: Rows) -> Lost | None:
    """Return the first step between `rows` over which M ceases to be positive definite, or None."""
    lighter = indefinite(system, rows)
    if lighter is None:
        return None
    return Lost(lighter - 1, Verdict.INDEFINITE, _LIGHTER.format(rows.t[lighter]))


def indefinite(system: MechanicalSystem, rows: Rows) -> int | None:
    """Return the first row at which M is negative in more directions than at row 0, or None.

    Only directions z that the constraints permit count, Phi_q z = 0: a coordinate without mass may
    be held by a constraint. M cannot lose its definiteness along a motion, because accelerations
    are infinite where it is singular; only a step of finite length passes over that.
    """
    block = max(_ENTRIES // system.n_q**2, 1)
    for k in range(0, len(rows.t) - 1, block):
        found = _first(system, Rows(*(x[k : k + block + 1] for x in rows)))
        if found is not None:
            return k + found
    return None


def _first(system: MechanicalSystem, rows: Rows) -> int | None:
    """Return the result of `indefinite` for rows whose matrices fit into memory together."""
    t, q, _ = rows
    local = system.linearise(t, q, None, 0 * q, np.zeros((len(t), system.n_lam)))
    mass = system.pattern.dense(local.M.real)
    # Scaling by a congruence, which keeps signs: entries have the units of their coordinates.
    scale = np.sqrt(np.abs(np.diagonal(mass, axis1=1, axis2=2)))
    scale = np.where(scale > 0, scale, 1.0)
    proof = mass = mass / scale[:, :, None] / scale[:, None, :]
    held = np.zeros((len(mass), 0, system.n_q))
    if system.n_lam:
        held = system.constraint_pattern.dense(local.Phi_q.real)
        held = held / scale[:, None, :]
        held /= np.maximum(np.linalg.norm(held, axis=2, keepdims=True), np.finfo(float).tiny)
        # If z^T (M + Phi_q^T Phi_q) z > 0 for all z, then z^T M z > 0 where Phi_q z = 0.
        proof = mass + held.swapaxes(1, 2) @ held
    if not np.isfinite(proof).all():
        return None  # The integrator finds values that are not finite.
    try:
        np.linalg.cholesky(proof)
        return None
    except np.linalg.LinAlgError:
        negative = np.array([_negative(*pair) for pair in zip(mass, held, strict=True)])
    more = negative > negative[0]
    return int(np.argmax(more)) if more.any() else None


def _negative(mass: Array, held: Array) -> int:
    """Return the number of directions z with Phi_q z = 0 in which M is negative."""
    free = scipy.linalg.null_space(held) if len(held) else np.eye(len(mass))
    values = np.linalg.eigvalsh(free.T @ mass @ free)
    return int(np.sum(values < _NEGATIVE * np.abs(values).max(initial=0.0)))
