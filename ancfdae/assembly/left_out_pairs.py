"""Check for pairs of bodies that `reach` leaves out of a contact load but that touch."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from ancfdae.assembly.naming import SceneNaming
from ancfdae.equations.solution_parts import MissedContact
from ancfdae.model.loads.pair_contact import PairContact
from ancfdae.model.parts import Elements
from ancfdae.numerics.arrays import Array

# Largest change of a gap over the largest path of a node: balls around elements move and grow with
# both of their ends.
_WAYS: Final = 5.0
# Smallest gap that is tested, as a fraction of the reach; below it only contact is tested.
_LEAST: Final = 2.0**-7


@final
class LeftOutPairs:
    """Search along the cubic path of a run for pairs that touch but are left out.

    If all gaps of such pairs exceed g, none touches before a node has moved by g / 5.
    """

    def __init__(self, load: PairContact, naming: SceneNaming, elements: Elements) -> None:
        assert load.reach is not None
        self._load, self._naming, self._reach = load, naming, load.reach
        self._names = (*load.whole_beams, *load.whole_bodies)
        never = load.adjoining(load.places(elements))
        self._listed = set(map(tuple, np.concatenate([load.pairs(elements), never]).tolist()))
        self._missed: MissedContact | None = None
        # Remaining path of nodes until gaps are measured again; m.
        self._left = 0.0

    def follow(self, t: Array, q: Array, v: Array) -> None:
        """Examine consecutive states of the run."""
        if self._missed is not None or len(t) < 2:
            return
        way = np.concatenate([[0.0], np.cumsum(self._ways(t, q, v))])
        done = 0.0
        while way[-1] - done > self._left:
            done += self._left
            k = int(np.clip(np.searchsorted(way, done, side="right") - 1, 0, len(t) - 2))
            s = min((done - way[k]) / (way[k + 1] - way[k]), 1.0)
            places = self._places(_on_cubic(s, (t, q, v), k))
            self._left = self._free_way(places)
            if not self._left:
                advice = (
                    f"Raise `reach` of load {self._load.name!r}, {self._reach:.6g}, or leave it "
                    "out: a pair touches that it left out."
                )
                self._missed = MissedContact(float(t[k] + s * (t[k + 1] - t[k])), advice)
                return
        self._left -= way[-1] - done

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
        """Return the node positions of each body in states q, shape (k, n_nodes, d) each; m."""
        return [self._naming.nodes(q, name)[:, :, 0] for name in self._names]

    def _free_way(self, places: list[Array]) -> float:
        """Return how far nodes may move before a pair touches, m; zero if one touches."""
        now, gap = [x[0] for x in places], self._reach / 2
        while gap > _LEAST * self._reach:
            if self._all_listed(now, gap):
                return gap / _WAYS
            gap /= 2
        return gap / _WAYS if self._all_listed(now, 0.0) else 0.0

    def _all_listed(self, places: list[Array], gap: float) -> bool:
        near = self._load.within(places, gap)
        return self._listed.issuperset(map(tuple, near.tolist()))


def _on_cubic(s: float, states: tuple[Array, Array, Array], k: int) -> Array:
    """Return the state at the fraction s of step k on the cubic through its ends, (1, n_q)."""
    t, q, v = states
    h, rise = t[k + 1] - t[k], q[k + 1] - q[k]
    bend, twist = 3 * rise - h * (2 * v[k] + v[k + 1]), h * (v[k] + v[k + 1]) - 2 * rise
    return np.asarray(q[k] + s * (h * v[k] + s * (bend + s * twist)))[None]
