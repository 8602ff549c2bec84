"""Files that are written whole or not at all."""

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, final

from ancfdae.errors import AncfdaeError, require_folder


@final
class NotSaved(AncfdaeError, OSError):
    """A file that could not be written, as on a full disk; what was there before is kept."""


@contextmanager
def saving(where: str, path: Path) -> Iterator[None]:
    """Raise NotSaved where the disk is full or refuses."""
    try:
        yield
    except OSError as error:
        raise NotSaved(
            f"{where} {str(path)!r}: must be written whole; got {error.strerror or error}. "
            "Make room on its disk or name another place; what was there before is kept."
        ) from error


@contextmanager
def replacing(where: str, path: Path) -> Iterator[IO[bytes]]:
    """Yield a temporary file that is moved to `path` when it is complete, and removed if not.

    InvalidInput if there is no such folder.
    """
    # Not a file of `tempfile`: those are readable by their owner only, and would stay so.
    require_folder(where, path)
    temporary = path.parent / f"{path.name}.{uuid.uuid4().hex}.part"
    try:
        with saving(where, path):
            with temporary.open("x+b") as file:
                yield file
            temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
