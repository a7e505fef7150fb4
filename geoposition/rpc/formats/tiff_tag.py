"""The RPC tag of a TIFF file (50844, RPCCoefficientTag), read as the 92 doubles it holds.

GDAL hands the tag out as decimal texts of 15 digits; reading the tag itself keeps every bit.
*Source*: GeoTIFF RPC tag proposal (GDAL RFC 22); TIFF 6.0; BigTIFF design.
"""

from __future__ import annotations

import struct
from pathlib import Path

from geoposition.errors import ProductError

RPC_TAG = 50844
RPC_COUNT = 92
_DOUBLE = 12
_MAX_ENTRIES = 65536


def is_tiff(head: bytes) -> bool:
    """Tell whether a file that begins with `head` is a TIFF or BigTIFF."""
    return head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def read_rpc_tag(path: Path) -> tuple[float, ...] | None:
    """Return the 92 numbers of the first image's RPC tag, or None where it has none."""
    try:
        with path.open("rb") as file:
            head = file.read(16)
            order = "<" if head[:2] == b"II" else ">"
            big = head[2:4] in (b"+\0", b"\0+")
            entry = struct.Struct(order + ("HHQQ" if big else "HHII"))
            count = struct.Struct(order + ("Q" if big else "H"))
            (first,) = struct.unpack_from(order + ("Q" if big else "I"), head, 8 if big else 4)
            file.seek(first)
            (n,) = count.unpack(file.read(count.size))
            if n > _MAX_ENTRIES:
                raise ProductError(path, "TIFF directory", f"{n} entries are too many to be true")
            directory = file.read(n * entry.size)
            for tag, kind, length, where in entry.iter_unpack(directory):
                if tag != RPC_TAG:
                    continue
                if kind != _DOUBLE or length != RPC_COUNT:
                    raise ProductError(
                        path, f"TIFF tag {RPC_TAG}",
                        f"{RPC_COUNT} doubles expected, got {length} of type {kind}",
                    )  # fmt: skip
                file.seek(where)
                return struct.unpack(f"{order}{RPC_COUNT}d", file.read(8 * RPC_COUNT))
    except (struct.error, OverflowError, OSError):
        raise ProductError(path, "TIFF directory", "a whole TIFF file expected") from None
    return None
