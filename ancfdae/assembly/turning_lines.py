"""Check that a beam that touches itself turns by less than a right angle in adjoining elements.

A point c of the line touches the closest point r of another element, (r - c) . r' = 0. Along the
line r - c is the integral of r' from c to r, so that (r - c) . r' > 0 if tangents between both have
positive products with each other. Tangents of a cubic lie in the cone of the Bezier points of r',

    l r'_1,   3 (r_2 - r_1) - l (r'_1 + r'_2),   l r'_2

and so have positive products if these vectors have.
"""

from __future__ import annotations

from typing import Final, final

import numpy as np

from ancfdae.assembly.naming import SceneNaming
from ancfdae.equations.solution_parts import MissedContact
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.loads.pair_contact import BeamPairContact
from ancfdae.model.parts import Elements
from ancfdae.numerics.arrays import Array

_RULE: Final = "must turn by less than a right angle in elements that do not touch each other"
_REMEDY: Final = "Take more elements: nine or more in a turn, and bends wider than the radius."


@final
class TurningLine:
    """Check of the line of one beam along a run; see the module."""

    def __init__(self, load: BeamPairContact, naming: SceneNaming, elements: Elements) -> None:
        self._beam, self._naming = load.beam, naming
        self._pairs = load.adjoining(load.places(elements)).T
        beam = naming.layout.beam(load.beam)
        self._lengths = naming.lengths[beam.elements].real[:, None]
        self._missed: MissedContact | None = None

    def require(self, q: Array) -> None:
        """Raise InvalidInputError if the rule does not hold in a state, (n_q,)."""
        wrong = self._wrong(q.real[None])[0]
        if np.any(wrong):
            element = int(self._pairs[0, np.argmax(wrong)])
            got = f"a turn of more at element {element} of {len(self._lengths)}"
            raise InvalidInputError(
                f"beam {self._beam!r}, which touches itself", _RULE, got, _REMEDY
            )

    def follow(self, t: Array, q: Array, v: Array) -> None:
        """Examine consecutive states of the run."""
        wrong = np.any(self._wrong(q), axis=1)
        if self._missed is None and np.any(wrong):
            words = f"Beam {self._beam!r}, which touches itself, {_RULE}. {_REMEDY}"
            self._missed = MissedContact(float(t[np.argmax(wrong)]), words)

    def missed(self) -> MissedContact | None:
        """Return the first time point at which the rule does not hold, or None."""
        return self._missed

    def _wrong(self, q: Array) -> Array:
        """Return for each adjoining pair of elements whether the rule fails, (k, n_pairs)."""
        ends = self._naming.ends(q, self._beam)
        rise = ends[:, :, 1, 0] - ends[:, :, 0, 0]
        first, last = (self._lengths * ends[:, :, end, 1] for end in (0, 1))
        tangents = np.stack([first, 3 * rise - first - last, last], axis=2)
        one, other = (tangents[:, at] for at in self._pairs)
        return np.asarray(~np.all(one @ np.swapaxes(other, 2, 3) > 0, axis=(2, 3)))
