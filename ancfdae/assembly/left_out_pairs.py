"""Search for pairs of bodies near each other, and for pairs left out by `reach` that touch."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from ancfdae.assembly.naming import SceneNaming
from ancfdae.equations.solution_parts import MissedContact
from ancfdae.model.loads.pair_contact import PairContact, without
from ancfdae.model.parts import Elements
from ancfdae.numerics.arrays import Array

# Largest change of a gap over the largest path of a node: balls around elements move and grow with
# both of their ends.
_WAYS: Final = 5.0
# Smallest gap that is tested, as a fraction of the reach; a pair with a smaller one counts as
# touching.
_LEAST: Final = 2.0**-7
# Fraction 1/_PARTS of the reach by which nodes move between states in which neighbours are sought.
_PARTS: Final = 20.0
# Least number of such states in the mean path of a step, which bounds shorter parts of a reach.
_PER_STEP: Final = 4.0
# Length of a step over the reach above which it is not examined before it is judged. A reach that
# is shorter beside the mean step counts as this part of it.
_FAR: Final = 100.0


def near_pairs(
    load: PairContact, naming: SceneNaming, elements: Elements, q: Array, wider: float
) -> Array:
    """Return the pairs of a load that are near in states q, (k, n_q), shape (n, 2), at least one.

    Gaps are at most the reach in one state, and half of it along a run. Along a run they are
    measured wherever a node has moved by 1/20 of the reach, by which gaps change by 1/4 of it, or
    by more where no further pair could come so near. A reach below 5 times the mean path of a step
    counts as that much. `wider` multiplies the reach.
    """
    assert load.reach is not None
    places, reach = _places(load, naming, q), wider * load.reach
    steps = [np.linalg.norm(np.diff(x, axis=0), axis=2).max(axis=1) for x in places]
    way, done, found = np.concatenate([[0.0], np.cumsum(np.max(steps, axis=0))]), 0.0, list[Array]()
    mean = way[-1] / max(len(q) - 1, 1)
    reach = max(reach, mean * _PARTS / _PER_STEP)
    least = part = reach / _PARTS if len(q) > 1 else reach / (2 * _WAYS)
    while done <= way[-1]:
        at = np.interp(done, way, np.arange(len(way)))
        k = min(int(at), len(q) - 1)
        now = [x[k] + (at - k) * (x[min(k + 1, len(x) - 1)] - x[k]) for x in places]
        found.append(load.within(now, reach / 2 + _WAYS * least))
        part *= 2
        while part > least and done < way[-1]:
            if len(load.within(now, reach / 2 + _WAYS * part)) == len(found[-1]):
                break
            part /= 2
        done += part
    near = np.unique(np.concatenate(found), axis=0)
    near = without(near, load.adjoining(load.places(elements)))
    return near if len(near) else load.pairs(elements)


def _places(load: PairContact, naming: SceneNaming, q: Array) -> list[Array]:
    """Return the node positions of each body in states q, shape (k, n_nodes, d) each; m."""
    names = (*load.whole_beams, *load.whole_bodies)
    return [naming.nodes(q, name)[:, :, 0] for name in names]


@final
class LeftOutPairs:
    """Search along the cubic path of a run for pairs that touch but are left out.

    If all gaps of such pairs exceed g, none touches before a node has moved by g / 5. They are
    measured again then, so that no pair has touched when one is found.
    """

    def __init__(self, load: PairContact, naming: SceneNaming, elements: Elements) -> None:
        assert load.reach is not None
        self._load, self._naming, self._reach = load, naming, load.reach
        never = load.adjoining(load.places(elements))
        self._known = np.concatenate([load.pairs(elements), never])
        self._missed: MissedContact | None = None
        # Remaining path of nodes until gaps are measured again, and smallest gap tested; m.
        self._left, self._gap = 0.0, self._reach / 2

    def follow(self, t: Array, q: Array, v: Array) -> None:
        """Examine consecutive states of the run."""
        if self._missed is not None or len(t) < 2:
            return
        way = np.concatenate([[0.0], np.cumsum(self._ways(t, q, v))])
        least = _LEAST * max(self._reach, way[-1] / (len(t) - 1) / _FAR)
        done = 0.0
        while way[-1] - done > self._left:
            done += self._left
            k = int(np.clip(np.searchsorted(way, done, side="right") - 1, 0, len(t) - 2))
            s = min((done - way[k]) / (way[k + 1] - way[k]), 1.0)
            places = self._places(_on_cubic(s, (t, q, v), k))
            self._left = self._free_way(places, least)
            if not self._left:
                advice = (
                    f"Raise `reach` of load {self._load.name!r}, {self._reach:.6g}, or leave it "
                    "out: a pair touches that it left out, in a run that does not search again."
                )
                self._missed = MissedContact(float(t[k] + s * (t[k + 1] - t[k])), advice)
                return
        self._left -= way[-1] - done

    def tried(self, t: Array, q: Array, v: Array) -> tuple[Array, MissedContact] | None:
        """Return the first state, (1, n_q), of a step at which a pair left out touches, or None.

        The step, from the last state examined, is not followed further. Steps longer than 100 times
        the reach are not examined: they diverged, or are rejected with all pairs too.
        """
        if not np.sum(self._ways(t, q, v)) < _FAR * self._reach:
            return None
        left = self._left
        self.follow(t, q, v)
        missed, self._missed, self._left = self._missed, None, left
        if missed is None:
            return None
        k = int(np.clip(np.searchsorted(t, missed.time) - 1, 0, len(t) - 2))
        return _on_cubic((missed.time - t[k]) / (t[k + 1] - t[k]), (t, q, v), k), missed

    def missed(self) -> MissedContact | None:
        """Return the first time at which a pair touches that the load leaves out, or None."""
        return self._missed

    def _ways(self, t: Array, q: Array, v: Array) -> Array:
        """Return upper bounds of the path of the nodes in each step, shape (k,); m."""
        h = np.diff(t)[:, None]
        middle = 3 * np.diff(q, axis=0) - h * (v[:-1] + v[1:])
        rates = [self._places(x) for x in (h * v[:-1], middle, h * v[1:])]
        sizes = [np.linalg.norm(np.concatenate(x, axis=1), axis=2).max(axis=1) for x in rates]
        return np.asarray(np.max(sizes, axis=0))

    def _places(self, q: Array) -> list[Array]:
        return _places(self._load, self._naming, q)

    def _free_way(self, places: list[Array], least: float) -> float:
        """Return how far nodes may move before a pair touches, m; zero if one may touch next.

        A pair with a smaller gap than `least`, m, may.
        """
        now, gap = [x[0] for x in places], max(2 * self._gap, self._reach / 2, 2 * least)
        while gap > least:
            if self._all_listed(now, gap):
                self._gap = gap
                return gap / _WAYS
            gap /= 2
        return 0.0

    def _all_listed(self, places: list[Array], gap: float) -> bool:
        return not len(without(self._load.within(places, gap), self._known))


def _on_cubic(s: float, states: tuple[Array, Array, Array], k: int) -> Array:
    """Return the state at the fraction s of step k on the cubic through its ends, (1, n_q)."""
    t, q, v = states
    h, rise = t[k + 1] - t[k], q[k + 1] - q[k]
    bend, twist = 3 * rise - h * (2 * v[k] + v[k + 1]), h * (v[k] + v[k + 1]) - 2 * rise
    return np.asarray(q[k] + s * (h * v[k] + s * (bend + s * twist)))[None]
