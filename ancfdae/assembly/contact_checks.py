"""Checks for contacts that the steps of a run do not resolve, or that a load leaves out.

The forces of a contact load are examined on each body and each node of a beam by itself, in the
norm of W^(-1/2), W the weights of the coordinates, so that impulses are changes of W^(1/2) v. A
contact is a row of time points with a force F_k on one body or node. It is resolved if

    n = (sum of F_k)^2 / (sum of F_k^2)

is at least `_FEWEST`: the number of time points over which its impulse is spread. Contacts that a
step passes over between two time points are found by `passed_contacts`. A contact counts if its
impulse is at least `_SMALL` of the largest momentum, or contact impulse, that the body or node has
in the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, final

import numpy as np

from ancfdae.assembly.left_out_pairs import LeftOutPairs
from ancfdae.assembly.load_forces import MovingLoad
from ancfdae.assembly.naming import SceneNaming
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.passed_contacts import Passed, passed_contacts
from ancfdae.assembly.turning_lines import TurningLine
from ancfdae.equations.solution_parts import ContactRecord, MissedContact
from ancfdae.model.loads.contact import ContactLoad
from ancfdae.model.loads.pair_contact import BeamPairContact, PairContact
from ancfdae.model.parts import Elements
from ancfdae.numerics.arrays import Array

# Number of time points over which an impulse must be spread: the speed after a free impact then
# errs by 5 % at most, by HHT and Radau (docs/theory/19-contact.md).
_FEWEST: Final = 6.0
# Impulse over largest momentum of a body below which a contact does not count.
_SMALL: Final = 0.01
# Fraction of its duration over which the impulse of a free impact is spread (undamped, m = 1.5).
_SPREAD: Final = 0.8
# Largest number of entries of states that are examined at once.
_ROOM: Final = 2**20


class Groups(NamedTuple):
    """Groups of coordinates, bodies or beam nodes: first coordinate, root of weights, names."""

    starts: Array
    root: Array
    names: tuple[str, ...]

    @staticmethod
    def of(numbering: Numbering, weights: Array) -> Groups:
        """Return the groups of a scene; the states of all controllers are one more group."""
        starts, d = numbering.positions * numbering.d, numbering.d
        names = [body.name for body in numbering.bodies for _ in body.positions]
        if len(numbering.masses):
            starts = np.append(starts, numbering.n_q - d * len(numbering.masses))
            names.append("controllers")
        return Groups(starts, np.sqrt(weights), tuple(names))

    def momenta(self, v: Array) -> Array:
        """Return the norms of W^(1/2) v of each group, shape (k, n), for v, (k, n_q)."""
        return self._sizes(v * self.root)

    def forces(self, Q: Array) -> Array:
        """Return the norms of W^(-1/2) Q of each group, shape (k, n), for Q, (k, n_q)."""
        return self._sizes(Q / self.root)

    def of_coordinates(self, columns: Array) -> Array:
        """Return the groups to which coordinates, shape (k,), belong."""
        return np.searchsorted(self.starts, columns, side="right") - 1

    def _sizes(self, x: Array) -> Array:
        return np.sqrt(np.add.reduceat(x * x, self.starts, axis=-1))


class _Suspect(NamedTuple):
    """A contact that is not resolved, if its impulse counts, with the group that it acts on."""

    begin: float
    impulse: float
    group: int
    words: str


@final
class RunContacts(ContactRecord):
    """Record of the contacts of one run, by all contact loads of a scene."""

    def __init__(
        self,
        loads: Sequence[MovingLoad],
        naming: SceneNaming,
        elements: Elements,
        groups: Groups,
        start: Array,
    ) -> None:
        """Take the loads and the state q at the start of the run, (n_q,).

        Raises InvalidInputError if a beam that touches itself has too few elements there.
        """
        self._groups, self._scale = groups, np.zeros(len(groups.starts))
        self._loads = [_LoadContacts(load, groups, self._scale) for load in loads]
        pairs = [x.item.load for x in loads]
        lines = [
            TurningLine(load, naming, elements)
            for load in pairs
            if isinstance(load, BeamPairContact) and load.other_radius is None
        ]
        for line in lines:
            line.require(start)
        self._pairs: list[LeftOutPairs | TurningLine] = [
            LeftOutPairs(load, naming, elements)
            for load in pairs
            if isinstance(load, PairContact) and load.reach is not None
        ]
        self._pairs += lines
        self._last: tuple[Array, Array, Array] | None = None

    def follow(self, t: Array, q: Array, v: Array) -> None:
        """Examine the next states of the run; states that were examined already are skipped."""
        states = t, q.real, v.real
        if self._last is not None:
            # At the last time, if it comes again, velocities may have jumped.
            again = bool(np.any(t == self._last[0]))
            new = t >= self._last[0] if again else t > self._last[0]
            before = tuple(x[: 1 - again] for x in self._last)
            states = tuple(  # type: ignore[assignment]
                np.concatenate([x, y[new]]) for x, y in zip(before, states, strict=True)
            )
        size = max(1, _ROOM // q.shape[1])
        begin = self._last is None
        for k in range(0, max(len(states[0]) - 1, 1), size):
            some = tuple(x[k : k + size + 1] for x in states)
            self._look(some, begin and k == 0)  # type: ignore[arg-type]
        self._last = tuple(x[-1:].copy() for x in states)  # type: ignore[assignment]

    def passes(self, t: Array, q: Array, v: Array) -> bool:
        """Whether surfaces touch between two time points, (2,), but at neither of them."""
        return any(load.passes((t, q.real, v.real)) for load in self._loads)

    def _look(self, states: tuple[Array, Array, Array], begin: bool) -> None:
        largest = self._groups.momenta(states[2]).max(axis=0)
        np.maximum(self._scale, largest, out=self._scale)
        for load in self._loads:
            load.follow(states, begin)
        for each in self._pairs:
            each.follow(*states)

    def missed(self) -> MissedContact | None:
        """Return the first contact that the run does not resolve, or None."""
        found = [x.missed() for x in (*self._loads, *self._pairs)]
        return min((x for x in found if x is not None), default=None, key=lambda x: x.time)


@final
class _LoadContacts:
    """Contacts of one load, on each group; `scale` is the largest momentum or impulse, (n,)."""

    def __init__(self, load: MovingLoad, groups: Groups, scale: Array) -> None:
        self._load, self._groups, self._scale = load, groups, scale
        n = len(scale)
        # Open contacts: their begin, sums of F and F^2, impulse, and time points.
        self._begin, self._open = np.full(n, -np.inf), np.zeros((4, n))
        self._suspects = list[_Suspect]()

    def follow(self, states: tuple[Array, Array, Array], begin: bool) -> None:
        """Examine the contacts in consecutive states, the first of which was examined before."""
        t, q, v = states
        F = self._groups.forces(self._load.force(q, v, t).real)
        for group in np.flatnonzero(np.any(F != 0, axis=0)).tolist():
            self._rows(group, t, F[:, group], begin)
        for each in passed_contacts(self._load, self._groups, states, F):
            self._add_passed(each)

    def passes(self, states: tuple[Array, Array, Array]) -> bool:
        """Whether surfaces touch between two time points only; False for loads without a depth."""
        if not isinstance(self._load.item.load, ContactLoad):
            return False
        t, q, v = states
        F = self._groups.forces(self._load.force(q, v, t).real)
        found = passed_contacts(self._load, self._groups, states, F)
        return any(np.any(self._counts(slice(None), each.impulses)) for each in found)

    def _rows(self, group: int, t: Array, F: Array, begin: bool) -> None:
        """Add the contact forces on a group to its contacts, and check contacts that end."""
        rows = np.stack([F[1:], F[1:] ** 2, np.diff(t) * (F[:-1] + F[1:]) / 2, F[1:] != 0])
        if begin and F[0]:
            self._open[:, group] = F[0], F[0] ** 2, 0.0, 1.0
        ends = np.flatnonzero((F[1:] == 0) & (F[:-1] != 0))
        first = 0
        for end in ends.tolist():
            self._open[:, group] += rows[:, first : end + 1].sum(axis=1)
            if F[first] == 0:
                at = first + int(np.argmax(F[first + 1 :] != 0))
                self._begin[group] = t[at]
            self._close(group, float(t[end + 1]))
            first = end + 1
        self._open[:, group] += rows[:, first:].sum(axis=1)
        if F[-1] and F[first] == 0:
            self._begin[group] = t[first + int(np.argmax(F[first + 1 :] != 0))]
        impulse = self._open[2, group]
        self._scale[group] = max(self._scale[group], impulse)

    def _close(self, group: int, end: float) -> None:
        """Check a contact that ended, unless the run began in it and it may have lasted longer."""
        begin, (total, squares, impulse, points) = float(self._begin[group]), self._open[:, group]
        self._scale[group] = max(self._scale[group], impulse)
        spread = total**2 / squares
        if begin > -np.inf and spread < _FEWEST and self._counts(group, impulse):
            lasts = end - begin
            words = (
                f"lasts {lasts:.3g} s, and its impulse is spread over {spread:.2g} time points for "
                f"{_FEWEST:g} at least. {_remedy(lasts * min(spread / (points + 1), _SPREAD))}"
            )
            self._suspects.append(_Suspect(begin, impulse, group, words))
        self._open[:, group] = 0.0

    def _add_passed(self, found: Passed) -> None:
        for group in np.flatnonzero(self._counts(slice(None), found.impulses)).tolist():
            lasts = found.end - found.begin
            words = (
                f"lasts {lasts:.3g} s, between two time points. {_remedy(_SPREAD * lasts)} DOP853 "
                f"and IDA see it with stops=({found.begin + lasts / 4:.12g},)."
            )
            self._suspects.append(_Suspect(found.begin, float(found.impulses[group]), group, words))

    def _counts(self, group: int | slice, impulse: Array | float) -> Array:
        return np.asarray(impulse > _SMALL * self._scale[group])

    def missed(self) -> MissedContact | None:
        """Return the first contact of this load that is not resolved and counts, or None."""
        bad = [x for x in self._suspects if self._counts(x.group, x.impulse)]
        if not bad:
            return None
        first = min(bad, key=lambda x: x.begin)
        name, body = self._load.item.load.name, self._groups.names[first.group]
        words = f"The contact of load {name!r} with {body!r} from t = {first.begin:.6g} s on"
        return MissedContact(first.begin, f"{words} {first.words}")


def _remedy(spread: float) -> str:
    """Return the remedy in words for a contact whose impulse is spread over this time, s."""
    return (
        f"Take steps of {spread / 8:.2g} s in HHT or {spread / 4:.2g} s in Radau, error control "
        "with a smaller rtol than before, as in HHT(rtol=1e-5), or a softer contact."
    )
