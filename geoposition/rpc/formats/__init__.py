"""RPC files in every dialect: `read_rpc` knows them by content, `write_rpc` by the file's name.

Inside, pixels are 0-based with the first pixel's centre at (0, 0) and heights are metres above
the WGS 84 ellipsoid; each dialect's module says what its files hold.
"""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from pathlib import Path

from geoposition.errors import ArgumentError, ProductError, UnsupportedError
from geoposition.rpc.formats import (
    dimap,
    dimap_system,
    geom,
    geotiff,
    maxar_xml,
    own_json,
    rpb,
    rpc_txt,
)
from geoposition.rpc.formats._files import read_head, read_text
from geoposition.rpc.model import RpcModel
from geoposition.xmlfile import read_xml

__all__ = ["DIALECTS", "read_rpc", "write_rpc"]

_Read = Callable[[Path], RpcModel]
_Write = Callable[[RpcModel, Path], None]

DIALECTS: dict[str, tuple[_Read, _Write]] = {
    "rpb": (rpb.read, rpb.write),
    "rpc_txt": (rpc_txt.read, rpc_txt.write),
    "dimap": (dimap.read, dimap.write),
    "dimap_system": (dimap_system.read, dimap_system.write),
    "maxar_xml": (maxar_xml.read, maxar_xml.write),
    "geotiff": (geotiff.read, geotiff.write),
    "geom": (geom.read, geom.write),
    "json": (own_json.read, own_json.write),
}
"""Reader and writer of each dialect, by name."""

_XML_ROOTS = {
    dimap.ROOT: "dimap",
    dimap_system.ROOT: "dimap_system",
    maxar_xml.ROOT: "maxar_xml",
}
_SUFFIXES = {
    ".rpb": "rpb",
    ".txt": "rpc_txt",
    ".xml": "dimap",
    ".geom": "geom",
    ".json": "json",
    ".tif": "geotiff",
    ".tiff": "geotiff",
}


def read_rpc(path: str | PathLike[str]) -> RpcModel:
    """Read the RPC in `path`, whatever its dialect.

    An image without an RPC of its own is answered from the file beside it. A file that is
    none, or that is damaged, is a `ProductError` naming the file and the key; a kind that is
    known and cannot be used is an `UnsupportedError`.
    """
    path = Path(path)
    return DIALECTS[sniff(path)][0](path)


def sniff(path: Path) -> str:
    """Name of the dialect of `path`, by content."""
    head = read_head(path)
    if geotiff.recognises(head):
        return "geotiff"
    begin = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if begin.startswith(b"<") or head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        root = read_xml(path).tag
        if root == "VRTDataset":
            raise UnsupportedError(path, root, "a GDAL VRT: give the RPC file it was made from")
        if root not in _XML_ROOTS:
            raise UnsupportedError(
                path, root, f"an XML file with an RPC ({', '.join(_XML_ROOTS)}) expected"
            )
        return _XML_ROOTS[root]
    if begin.startswith(b"{"):
        return "json"
    text = read_text(path)
    for name, module in (("geom", geom), ("rpb", rpb), ("rpc_txt", rpc_txt)):
        if module.recognises(text):
            return name
    raise ProductError(path, "", "an RPC expected, the content is of no known dialect")


def dialect_for(path: Path) -> str:
    """Name of the dialect in which `path` is written, by its ending."""
    dialect = _SUFFIXES.get(path.suffix.lower())
    if dialect is None:
        raise UnsupportedError(
            path, "name", ".RPB, _RPC.TXT, .XML, .geom, .json or .tif expected at its end"
        )
    return dialect


def write_rpc(model: RpcModel, path: str | PathLike[str], dialect: str | None = None) -> None:
    """Write `model` to `path`, whole or not at all, at full precision.

    The name decides: `.RPB`, `_RPC.TXT`, `.XML` (DIMAP), `.geom`, `.json`, `.tif` (the tag of
    an existing TIFF, or a new image without pixels), unless `dialect` names one of `DIALECTS`.
    """
    path = Path(path)
    if dialect is None:
        dialect = dialect_for(path)
    if dialect not in DIALECTS:
        raise ArgumentError(f"dialect: one of {', '.join(DIALECTS)} expected, got {dialect!r}")
    if path.is_dir():
        raise ProductError(path, "", "a file name expected, this is a folder")
    DIALECTS[dialect][1](model, path)
