"""What an adjoint starts from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Seeds:
    """Partials of an objective in the states of every instant, rows; None for none.

    Attributes
    ----------
    q, v : array, shape (n_t, n_q), or None
    lam : array, shape (n_t, n_lam), or None
    over_time : bool
        Whether the rows are weights of a quadrature times smooth functions of time.
    """

    q: Array | None
    v: Array | None
    lam: Array | None
    over_time: bool = False
