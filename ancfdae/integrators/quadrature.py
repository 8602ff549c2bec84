"""Integrals beside the motion, refined until their own error is within the tolerance."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import final

import numpy as np

from ancfdae.integrators.index_1 import Accelerations
from ancfdae.integrators.integrand import Integrand, PartialIntegral, Points, Rule
from ancfdae.integrators.multipliers import Multipliers, Trajectory

# Gauss-Lobatto rule of four points with its Kronrod extension of seven, of degrees 5 and 9
# (Gander & Gautschi, BIT 40, 2000), moved from [-1, 1] to [0, 1].
_X = np.sqrt([1.0, 2 / 3, 1 / 5, 0.0])
SHARES = 0.5 + 0.5 * np.array([-_X[0], -_X[1], -_X[2], 0.0, _X[2], _X[1], _X[0]])
_W = 0.5 * np.array([11 / 210, 72 / 245, 125 / 294, 16 / 35, 125 / 294, 72 / 245, 11 / 210])
_LOBATTO = 0.5 * np.array([1 / 6, 0.0, 5 / 6, 0.0, 5 / 6, 0.0, 1 / 6])
_SIMPSON = np.array([1 / 6, 0.0, 0.0, 4 / 6, 0.0, 0.0, 1 / 6])
KRONROD = Rule(_W, _W - _LOBATTO, _W - _SIMPSON)
# Estimated error that is accepted, in tolerances: the integral of a run is then within one to ten
# of them (measured against a thousand panels), and what the states are off by is more.
_ACCEPTED = 10.0


@final
class Quadrature:
    """Feeds integrands part by part.

    Where points come without multipliers an integrand is tried without: if that is not a number it
    reads them, and from then on they are found for it, by `accelerations` (`Multipliers`).
    """

    def __init__(
        self, integrands: Sequence[Integrand], accelerations: Accelerations, rtol: float
    ) -> None:
        self._integrands = tuple(integrands)
        self._multipliers = Multipliers(accelerations, _ACCEPTED * rtol)
        self._largest, self._readers = _ACCEPTED * rtol, set[Integrand]()

    @property
    def wanted(self) -> bool:
        """Whether there is anything to integrate."""
        return bool(self._integrands)

    def add(self, choices: Iterable[Points], steps: Trajectory | None = None) -> None:
        """Take in the next part of the run, with its steps if multipliers are to follow them.

        The choices are the same part on ever finer panels; each integrand takes the first on which
        its error is accepted, or the last.
        """
        self._multipliers.follow(steps)
        pending, unfinished = self._integrands, list[tuple[Integrand, PartialIntegral]]()
        for choice in choices:
            unfinished = []
            for integrand, part in self._parts(choice, pending):
                if part.error <= self._largest:
                    integrand.add(part)
                else:
                    unfinished.append((integrand, part))
            pending = tuple(integrand for integrand, _ in unfinished)
            if not pending:
                return
        for integrand, part in unfinished:
            integrand.add(part)

    def _parts(
        self, points: Points, integrands: Sequence[Integrand]
    ) -> list[tuple[Integrand, PartialIntegral]]:
        """Evaluate integrands, with multipliers only those that read them."""
        parts = [(x, x.part(points)) for x in integrands if x not in self._readers]
        if points.lam is None:
            self._readers.update(x for x, part in parts if part.not_finite is not None)
        readers = [x for x in integrands if x in self._readers]
        if not readers:
            return parts
        completed = self._completed(points)
        others = [(x, part) for x, part in parts if x not in self._readers]
        return others + [(x, x.part(completed)) for x in readers]

    def _completed(self, points: Points) -> Points:
        """Add multipliers where there are none."""
        if points.lam is not None:
            return points
        multipliers = self._multipliers.at(
            Trajectory(points.t, points.q, points.v, points.q_b, points.v_b)
        )
        lam_b = None if points.q_b is None else multipliers[..., 1:]
        return replace(points, lam=multipliers[..., 0], lam_b=lam_b)
