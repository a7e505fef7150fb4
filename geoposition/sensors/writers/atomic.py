"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from geoposition.errors import ProductError


def files_whole(texts: Mapping[Path, str]) -> None:
    """Write each text (UTF-8, as it is) to its path: all of them, or none.

    All are first written beside their places; where that fails, because a folder is missing or
    the disk is full, a `ProductError` is raised, what was there stays, and nothing is left over.
    Then they are put in place in the order given: the last one is the one that counts.
    """
    temporary: dict[Path, Path] = {}
    at = Path()
    try:
        for at, text in texts.items():
            temporary[at] = _written_beside(at, text)
        for at, written in temporary.items():
            written.replace(at)
    except OSError as error:
        raise ProductError(at, "", f"a writable place expected ({error.strerror})") from None
    finally:
        for written in temporary.values():
            with suppress(OSError):
                written.unlink(missing_ok=True)


def _written_beside(path: Path, text: str) -> Path:
    handle, name = tempfile.mkstemp(prefix=f".{path.name[:40]}.", suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        Path(name).chmod(0o666 & ~umask)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    return Path(name)
