"""Record of the contacts of a run: a contract that systems with loads of contact fulfil."""

import abc
from typing import NamedTuple, final

from ancfdae.numerics.arrays import Array


@final
class MissedContact(NamedTuple):
    """The time, s, from which on a run is not to be trusted, with advice."""

    time: float
    advice: str


class ContactRecord(abc.ABC):
    """Follows the states of one run, packet by packet, and judges its contacts at the end."""

    @abc.abstractmethod
    def follow(self, t: Array, q: Array, v: Array) -> None:
        """Look at the next time points, (k,), with rows of q and v, (k, n_q).

        Time points before the last one that was looked at are left out, so that packets may
        overlap or come again. The last one may have other velocities, after an impact.
        """

    @abc.abstractmethod
    def passes(self, t: Array, q: Array, v: Array) -> bool:
        """Whether surfaces touch between two time points, (2,), at neither of which they do."""

    @abc.abstractmethod
    def missed(self) -> MissedContact | None:
        """Return the first contact that the steps do not resolve, None if they resolve all."""
