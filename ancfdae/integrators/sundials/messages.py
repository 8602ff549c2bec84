"""Keeps error messages of SUNDIALS off the terminal: the outcome of a run reports the same.

scikit-sundae prints them from its error handler and has no switch for it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO, final

# How scikit-sundae begins what it prints.
_MESSAGE = "\n[IDA"


@contextmanager
def without_messages() -> Iterator[None]:
    """Drop what SUNDIALS prints inside the block; whatever else is printed comes through."""
    stream = sys.stdout
    if isinstance(stream, _Filter):  # Another thread is at it.
        stream = stream.stream
    if stream is not None:
        sys.stdout = _Filter(stream)
    try:
        yield
    finally:
        sys.stdout = stream


@final
class _Filter:
    """A stream without messages of SUNDIALS."""

    def __init__(self, stream: TextIO) -> None:
        self.stream, self._dropped = stream, False

    def write(self, text: str) -> int:
        """Write the text, unless it is a message or the line end after one."""
        message = text.startswith(_MESSAGE)
        if message or (self._dropped and text == "\n"):
            self._dropped = message
            return len(text)
        self._dropped = False
        return self.stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)
