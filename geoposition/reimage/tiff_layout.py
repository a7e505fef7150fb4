"""How a cloud-optimised GeoTIFF lies on disk: directories first, overviews before the image.

What the directories say of map, RPC and missing pixels is GDAL's own: it writes them into a
file without pixels, and they are taken from there.

*Source*: TIFF 6.0 section 2; BigTIFF design; GDAL's COG driver, "Header ghost area".
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Final

_SIZES: Final = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4,
                 16: 8, 17: 8, 18: 8}  # fmt: skip
_SHORT: Final = 3
_LONG: Final = 4
_LONG8: Final = 16

_SUBFILE, _WIDTH, _LENGTH, _COMPRESSION, _PREDICTOR = 254, 256, 257, 259, 317
_TILE_WIDTH, _TILE_LENGTH, _OFFSETS, _COUNTS = 322, 323, 324, 325
_STRIPS: Final = (273, 278, 279)
_OF_PIXELS: Final = (258, 262, 277, 284, 338, 339, 42113)
"""Tags that overviews have in common with the image: what a pixel is."""
_MOST_CLASSIC: Final = 2**32 - 2**20
_COPY: Final = 1 << 24

COMPRESSIONS: Final = {"none": 1, "lzw": 5, "deflate": 8, "zstd": 50000}

_GHOST_BODY: Final = (
    b"LAYOUT=IFDS_BEFORE_DATA\nBLOCK_ORDER=ROW_MAJOR\nBLOCK_LEADER=SIZE_AS_UINT4\n"
    b"BLOCK_TRAILER=LAST_4_BYTES_REPEATED\nKNOWN_INCOMPATIBLE_EDITION=NO\n "
)
_GHOST: Final = b"GDAL_STRUCTURAL_METADATA_SIZE=%06d bytes\n" % len(_GHOST_BODY) + _GHOST_BODY

Tags = Mapping[int, tuple[int, bytes]]
"""Type and little-endian bytes of each tag of a directory."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredLevel:
    """Tiles of an image or overview of `shape`, one after the other in `data`; their sizes."""

    shape: tuple[int, int]
    data: BinaryIO
    sizes: Sequence[int]


def framed(block: bytes | memoryview) -> tuple[bytes, bytes]:
    """Return what stands before and after a tile's bytes: their number, and the last four."""
    return struct.pack("<I", len(block)), bytes(block[-4:])


FRAME: Final = 8
"""Bytes that `framed` adds to a tile."""


def directory_of(content: bytes) -> Tags:
    """Read the first directory of a little-endian TIFF file."""
    (at,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, at)
    tags = {}
    for k in range(count):
        tag, kind, number, where = struct.unpack_from("<HHII", content, at + 2 + 12 * k)
        size = _SIZES[kind] * number
        start = where if size > 4 else at + 2 + 12 * k + 8
        tags[tag] = (kind, content[start : start + size])
    return tags


def assemble(
    path: Path,
    tags: Tags,
    levels: Sequence[StoredLevel],
    tile: int,
    compression: str,
    predictor: int,
) -> None:
    """Write `path` from the image and its overviews, the largest first; `tags` as GDAL has them."""
    common = {
        _COMPRESSION: _numbers(_SHORT, [COMPRESSIONS[compression]]),
        _TILE_WIDTH: _numbers(_SHORT, [tile]),
        _TILE_LENGTH: _numbers(_SHORT, [tile]),
    }
    if predictor > 1:
        common[_PREDICTOR] = _numbers(_SHORT, [predictor])
    shared = {tag: tags[tag] for tag in _OF_PIXELS if tag in tags}
    own = {tag: value for tag, value in tags.items() if tag not in (*_STRIPS, _PREDICTOR)}
    heads: list[dict[int, tuple[int, bytes]]] = []
    for number, level in enumerate(levels):
        head = dict(own if number == 0 else shared) | common
        head[_WIDTH] = _numbers(_LONG, [level.shape[1]])
        head[_LENGTH] = _numbers(_LONG, [level.shape[0]])
        if number:
            head[_SUBFILE] = _numbers(_LONG, [1])
        heads.append(head)
    total = sum(sum(level.sizes) + FRAME * len(level.sizes) for level in levels)
    big = total + 64 * sum(len(level.sizes) for level in levels) > _MOST_CLASSIC
    # twice: the directories' size does not depend on the offsets that they hold
    length = len(_directories(heads, levels, [0] * len(levels), big))
    starts, at = [0] * len(levels), length
    for number in reversed(range(len(levels))):
        starts[number] = at
        at += sum(levels[number].sizes) + FRAME * len(levels[number].sizes)
    with path.open("wb") as file:
        file.write(_directories(heads, levels, starts, big))
        for level in reversed(levels):
            level.data.seek(0)
            while block := level.data.read(_COPY):
                file.write(block)


def _numbers(kind: int, values: Sequence[int]) -> tuple[int, bytes]:
    code = {_SHORT: "H", _LONG: "I", _LONG8: "Q"}[kind]
    return kind, struct.pack(f"<{len(values)}{code}", *values)


def _directories(
    heads: Sequence[Tags], levels: Sequence[StoredLevel], starts: Sequence[int], big: bool
) -> bytes:
    """Header, ghost area and the directories one after the other."""
    out = BytesIO()
    first = 16 if big else 8
    begin = first + len(_GHOST) + len(_GHOST) % 2
    out.write(
        struct.pack("<2sHHHQ", b"II", 43, 8, 0, begin)
        if big
        else struct.pack("<2sHI", b"II", 42, begin)
    )
    out.write(_GHOST.ljust(begin - first, b"\0"))
    for number, (head, level) in enumerate(zip(heads, levels, strict=True)):
        offsets, at = [], starts[number]
        for size in level.sizes:
            offsets.append(at + FRAME // 2)
            at += size + FRAME
        tags = dict(head)
        tags[_OFFSETS] = _numbers(_LONG8 if big else _LONG, offsets)
        tags[_COUNTS] = _numbers(_LONG, level.sizes)
        out.write(_directory(tags, out.tell(), big, number + 1 == len(heads)))
    return out.getvalue()


def _directory(tags: Tags, start: int, big: bool, last: bool) -> bytes:
    """One directory at byte `start`, the values that it does not hold right behind it."""
    entry, room = (20, 8) if big else (12, 4)
    count, link = (8, 8) if big else (2, 4)
    values = BytesIO()
    behind = start + count + entry * len(tags) + link
    entries: list[Any] = []
    for tag, (kind, value) in sorted(tags.items()):
        number = len(value) // _SIZES[kind]
        field = value.ljust(room, b"\0")
        if len(value) > room:
            field = struct.pack("<Q" if big else "<I", behind + values.tell())
            values.write(value + b"\0" * (-len(value) % 8))
        entries.append(struct.pack("<HHQ" if big else "<HHI", tag, kind, number) + field)
    behind += values.tell()
    pad = -behind % 8
    following = 0 if last else behind + pad
    return b"".join(
        [
            struct.pack("<Q" if big else "<H", len(tags)),
            *entries,
            struct.pack("<Q" if big else "<I", following),
            values.getvalue(),
            b"\0" * pad,
        ]
    )
