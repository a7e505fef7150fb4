"""Reading text that may be anything, and writing files whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from geoposition.errors import MissingFileError, ProductError

MAX_TEXT_BYTES = 16 * 2**20


def read_head(path: Path, size: int = 4096) -> bytes:
    """First bytes of the file; a missing, empty or unreadable one is a `ProductError`."""
    if not path.exists():
        raise MissingFileError(path, "", "there is no such file")
    if not path.is_file():
        raise ProductError(path, "", "a file expected, this is a folder")
    try:
        with path.open("rb") as file:
            head = file.read(size)
    except OSError as error:
        raise ProductError(path, "", f"a readable file expected ({error.strerror})") from None
    if not head:
        raise ProductError(path, "", "an RPC expected, the file is empty")
    return head


def read_text(path: Path) -> str:
    """Text of the file, UTF-8 or Latin-1; binary content is a `ProductError`."""
    if path.stat().st_size > MAX_TEXT_BYTES:
        raise ProductError(path, "", "an RPC expected, the file is far too large for one")
    data = path.read_bytes()
    if b"\0" in data:
        raise ProductError(path, "", "an RPC expected, the content is binary")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`, which replaces it only if the block succeeds."""
    if not path.parent.is_dir():
        raise MissingFileError(path, "", "its folder does not exist")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write `text` whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
