"""Checks of relative tolerances."""

from __future__ import annotations

from ancfdae.errors import InvalidInput, require_positive


def require_rtol(where: str, rtol: float, least: float) -> None:
    """Refuse a relative tolerance that round-off or sense forbids.

    Raises
    ------
    InvalidInput
    """
    require_positive(where, rtol)
    if not least <= rtol <= 1e-2:
        raise InvalidInput(where, f"must lie in [{least:.0e}, 1e-2]", rtol, "Try 1e-8.")
