"""Progress of long calls, shown where asked for; what shows it is loaded only then."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, final


@final
class _Hidden:
    """Shows nothing."""

    def __init__(self, items: Iterable[Any]) -> None:
        self._items = items

    def __iter__(self) -> Iterator[Any]:
        return iter(self._items)

    def __enter__(self) -> _Hidden:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def update(self, count: float = 1) -> None:
        """Show nothing."""


def progress_bar(shown: bool, items: Iterable[Any] | None = None, **settings: Any) -> Any:
    """Return a bar over items, or over a `total`, as tqdm makes it."""
    if not shown:
        return _Hidden(() if items is None else items)
    from tqdm import tqdm

    return tqdm(items, **settings)
