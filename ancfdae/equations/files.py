"""Writing files completely or not at all."""

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import CalledProcessError
from typing import IO, final

from ancfdae.errors.checks import require_folder
from ancfdae.errors.kinds import AncfdaeError


@final
class SaveError(AncfdaeError, OSError):
    """A file could not be written, for example on a full disk; its previous version is kept."""


# Exceptions raised on a full disk, in this process or in one started to write (ffmpeg).
_REFUSED = OSError, CalledProcessError


@contextmanager
def saving(where: str, path: Path) -> Iterator[None]:
    """Raise SaveError if writing fails, as on a full disk or without permission."""
    try:
        yield
    except SaveError:
        raise
    except _REFUSED as error:
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise SaveError(
            f"{where} {str(path)!r}: must be written whole; got {reason}. "
            "Make room on its disk or name another place; what was there before is kept."
        ) from error


@contextmanager
def replacing(where: str, path: Path) -> Iterator[IO[bytes]]:
    """Yield a temporary file that is moved to `path` when it is complete, and removed if not.

    InvalidInputError if the folder of `path` does not exist.
    """
    require_folder(where, path)
    with replacing_path(where, path) as temporary, temporary.open("x+b") as file:
        yield file


@contextmanager
def replacing_path(where: str, path: Path) -> Iterator[Path]:
    """Yield the name of a temporary file beside `path`, which is moved there or removed.

    It has the same suffix, from which libraries infer the format.
    """
    # Not from `tempfile`, whose files are readable by their owner only and would remain so.
    temporary = path.parent / f"{path.stem}.{uuid.uuid4().hex}.part{path.suffix}"
    try:
        with saving(where, path):
            yield temporary
            temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
