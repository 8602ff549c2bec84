"""Record of the contacts of a run: base class for systems with contact loads."""

import abc
from typing import NamedTuple, Protocol, final

from ancfdae.numerics.arrays import Array


@final
class MissedContact(NamedTuple):
    """The time, s, from which on a run is unreliable because of a missed contact, with advice."""

    time: float
    advice: str


class LeftOut(Protocol):
    """Protocol of searches along a run for pairs of bodies that touch but are left out."""

    def follow(self, t: Array, q: Array, v: Array) -> None:
        """Examine consecutive time points, (k,), the first of which was the last before."""

    def missed(self) -> MissedContact | None:
        """Return the first time at which such a pair touches, or None."""


class ContactRecord(abc.ABC):
    """Base class of objects that follow the states of one run and check its contacts."""

    @abc.abstractmethod
    def follow(self, t: Array, q: Array, v: Array) -> None:
        """Examine the next time points, (k,), with rows of q and v, (k, n_q).

        Time points before the last one examined are skipped, so that packets may overlap or be
        repeated. The last one may have other velocities, after an impact.
        """

    @abc.abstractmethod
    def passes(self, t: Array, q: Array, v: Array) -> bool:
        """Return whether surfaces touch between two time points, (2,), but at neither of them."""

    @abc.abstractmethod
    def missed(self) -> MissedContact | None:
        """Return the first contact that the steps do not resolve; None if all are resolved."""
