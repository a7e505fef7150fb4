"""What went into a run: checksums of its input files."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Final

from geoposition.errors import MissingFileError

_HASHED_BYTES: Final = 64 * 2**20
"""Of larger files the checksum covers the first so many bytes, and says so."""


def checksum(path: Path) -> str:
    """SHA-256 of a file, of a large one's beginning, or a word why there is none."""
    if not path.is_file():
        return "a folder, or not a plain file"
    try:
        with path.open("rb") as file:
            head = file.read(_HASHED_BYTES)
    except OSError:
        raise MissingFileError(path, "", "readable file expected") from None
    size = path.stat().st_size
    note = "" if size <= _HASHED_BYTES else f" of the first {_HASHED_BYTES} of {size} bytes"
    return f"sha256 {hashlib.sha256(head).hexdigest()}{note}"
