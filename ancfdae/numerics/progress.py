"""Progress of long calls, shown where asked for; what shows it is loaded only then."""

from collections.abc import Iterable
from contextlib import ExitStack
from typing import Any, final


@final
class _Hidden(ExitStack):
    """A progress bar that shows nothing."""

    def update(self, count: float = 1) -> None:
        """Do nothing: this progress bar is hidden."""


def progress_bar(shown: bool, items: Iterable[Any] | None = None, **settings: Any) -> Any:
    """Return a bar over items, or over a `total`, as tqdm makes it."""
    if not shown:
        return _Hidden() if items is None else items
    from tqdm import tqdm

    return tqdm(items, **settings)
