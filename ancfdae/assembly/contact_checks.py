"""Contacts that the steps of a run pass over, or that a load does not list.

Between two time points the motion follows the cubic through positions and velocities at both. The
impulse of a load over this path is compared with the trapezoidal rule on its ends. A run
resolves a contact if their differences are a small part of the impulse of the contact. Where a step
jumps over a contact, or enters and leaves it within few steps, they are of its size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from ancfdae.assembly.load_forces import MovingLoad
from ancfdae.assembly.naming import SceneNaming
from ancfdae.errors.outcomes import MissedContact
from ancfdae.model.loads.pair_contact import PairContact
from ancfdae.model.parts import Elements
from ancfdae.numerics.arrays import Array

# Differences over the impulse of a contact from which on it is not resolved, and fewest steps of a
# contact: below, the speed after impacts of a ball was off by up to 5 % with HHT and Radau.
_UNRESOLVED: Final = 0.2
_FEWEST: Final = 4
# Contacts with less than this part of the largest impulse do not count.
_SMALL: Final = 0.01
# Parts of a step on the path: with a force at one of its ends, and without one.
_TOUCHING, _FREE = 4, 16
# Numbers of states that are looked at together.
_ROOM: Final = 2**21


@final
@dataclass(frozen=True, eq=False)
class ContactCheck:
    """Checks the path of a run against the contacts of one load."""

    load: MovingLoad
    naming: SceneNaming
    weights: Array
    elements: Elements

    def missed(self, t: Array, q: Array, v: Array) -> MissedContact | None:
        """Return the first contact that the run misses, None if it misses none."""
        found = [self._unresolved(t, q, v), self._not_listed(q)]
        return min((x for x in found if x is not None), default=None, key=lambda x: x.place)

    def _unresolved(self, t: Array, q: Array, v: Array) -> MissedContact | None:
        """Return the first contact whose impulse is not found by the trapezoidal rule."""
        h = np.diff(t)
        if not len(h):
            return None
        Q = self.load.force(q, v, t) / np.sqrt(self.weights)
        touching = np.any(Q != 0, axis=1)
        touching = touching[:-1] | touching[1:]
        impulse, off = np.zeros(len(h)), np.zeros(len(h))
        for parts, steps in ((_TOUCHING, touching), (_FREE, ~touching)):
            size = max(1, _ROOM // (parts * q.shape[1]))
            chosen = np.flatnonzero(steps & (h > 0))
            for k in np.split(chosen, range(size, len(chosen), size)):
                along, ends = self._along(parts, k, (t, q, v), Q)
                impulse[k], off[k] = h[k] * along, h[k] * ends
        return self._first(impulse, off, t, np.any(Q[[0, -1]] != 0, axis=1))

    def _along(
        self, parts: int, k: Array, states: tuple[Array, Array, Array], Q: Array
    ) -> tuple[Array, Array]:
        """Return the mean size of the force over steps k, and how far their ends are from it."""
        t, q, v = states
        total, size = (Q[k] + Q[k + 1]) / (2 * parts), np.zeros(len(k))
        size += (np.linalg.norm(Q[k], axis=1) + np.linalg.norm(Q[k + 1], axis=1)) / (2 * parts)
        h = (t[k + 1] - t[k])[:, None]
        for s in np.arange(1, parts) / parts:
            rise = q[k + 1] - q[k]
            bend, twist = 3 * rise - h * (2 * v[k] + v[k + 1]), h * (v[k] + v[k + 1]) - 2 * rise
            place = q[k] + s * (h * v[k] + s * (bend + s * twist))
            speed = v[k] + s * (2 * bend + 3 * s * twist) / h
            force = self.load.force(place, speed, t[k] + s * h[:, 0]) / np.sqrt(self.weights)
            total, size = total + force / parts, size + np.linalg.norm(force, axis=1) / parts
        return size, np.linalg.norm(total - (Q[k] + Q[k + 1]) / 2, axis=1)

    def _first(self, impulse: Array, off: Array, t: Array, at_ends: Array) -> MissedContact | None:
        """Return the first of the contacts, steps with impulses in a row, that is not resolved.

        `at_ends` says whether the run begins and ends with a force.
        """
        acting = np.concatenate([[False], impulse > 0, [False]])
        begins, ends = np.flatnonzero(np.diff(acting)).reshape(-1, 2).T
        if not len(begins):
            return None
        sums = [np.concatenate([[0.0], np.cumsum(x)]) for x in (impulse, off)]
        whole, wrong = (x[ends] - x[begins] for x in sums)
        # A contact in which the run begins or ends may be longer than that.
        cut = (at_ends[0] & (begins == 0)) | (at_ends[1] & (ends == len(impulse)))
        short = (ends - begins < _FEWEST) & ~cut
        bad = (short | (wrong > _UNRESOLVED * whole)) & (whole > _SMALL * whole.max())
        if not bad.any():
            return None
        first = int(np.argmax(bad))
        begin, end = int(begins[first]), int(ends[first])
        step = (t[end] - t[begin]) / (end - begin)
        advice = (
            f"The contact of load {self.load.item.load.name!r} from t = {t[begin]:.6g} s on takes "
            f"{end - begin} steps of {step:.3g} s. Take steps of a tenth of its duration, error "
            "control as in HHT(rtol=1e-4), or a softer contact."
        )
        return MissedContact(begin, advice)

    def _not_listed(self, q: Array) -> MissedContact | None:
        """Return the first time point at which a pair touches that `reach` leaves out."""
        load = self.load.item.load
        if not isinstance(load, PairContact) or load.reach is None:
            return None
        names = (*load.whole_beams, *load.whole_bodies)
        places = [self.naming.nodes(q.real, name)[:, :, 0] for name in names]
        listed = set(map(tuple, load.pairs(self.elements).tolist()))
        for k in range(len(q)):
            touching = load.within([x[k] for x in places], 0.0)
            if not listed.issuperset(map(tuple, touching.tolist())):
                advice = f"Raise `reach` of load {load.name!r}, {load.reach:.6g}, or leave it out."
                return MissedContact(k, advice)
        return None
