"""What a reader looks at to recognise a file: its path, its first bytes, its XML root."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from geoposition.errors import MissingFileError, ProductError

_HEAD_BYTES = 65536
_ROOT = re.compile(rb"<(?:[A-Za-z_][\w.-]*:)?([A-Za-z_][\w.-]*)[\s/>]")


@dataclass(frozen=True, slots=True)
class Source:
    """One file: `head` are its first 64 KiB, `xml_root` the root element's name if it is XML."""

    path: Path
    head: bytes
    xml_root: str | None

    @classmethod
    def of(cls, path: Path) -> Source:
        """Look at the file `path`; an empty or missing one is refused."""
        if not path.is_file():
            raise MissingFileError(path, "", "there is no such file")
        try:
            with path.open("rb") as file:
                head = file.read(_HEAD_BYTES)
        except OSError as error:
            raise ProductError(path, "", f"cannot be read ({error.strerror})") from None
        if not head:
            raise ProductError(path, "", "a product expected, the file is empty")
        return cls(path, head, _xml_root(head))


def _xml_root(head: bytes) -> str | None:
    if not head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return None
    body = re.sub(rb"<!--.*?-->|<\?.*?\?>|<!DOCTYPE[^>\[]*(\[.*?\])?\s*>", b"", head, flags=re.S)
    found = _ROOT.search(body)
    return found.group(1).decode("ascii", "replace") if found else None
