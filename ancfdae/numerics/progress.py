"""Progress bars of long calls; the package tqdm is loaded only when a bar is shown."""

from collections.abc import Iterable
from contextlib import ExitStack
from typing import Any, final


@final
class _Hidden(ExitStack):
    """A progress bar that displays nothing."""

    def update(self, count: float = 1) -> None:
        """Do nothing: this progress bar is hidden."""


def progress_bar(shown: bool, items: Iterable[Any] | None = None, **settings: Any) -> Any:
    """Return a tqdm bar over items, or with a `total`; if not shown, the items or a dummy bar."""
    if not shown:
        return _Hidden() if items is None else items
    from tqdm import tqdm

    return tqdm(items, **settings)
