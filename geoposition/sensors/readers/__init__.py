"""One module per product format; `open_product` finds the one that reads a path."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Protocol, cast

from geoposition.errors import MissingFileError, ProductError, UnsupportedError
from geoposition.product import Product
from geoposition.sensors.readers.source import Source


class Reader(Protocol):
    """What each reader module offers."""

    FORMAT: str
    CANDIDATES: tuple[str, ...]

    def recognises(self, source: Source) -> bool:
        """Tell whether `source` is of this format, by content."""
        ...

    def read(self, source: Source) -> Product:
        """Read the product of which `source` is the main file."""
        ...


_MODULES = (
    "digitalglobe",
    "dimap_v2",
    "pleiades_system",
    "dimap_v1",
    "csm",
    "model_file",
    "rpc_file",
)
"""Tried in this order: rigorous models first, an RPC where there is nothing better."""


def readers() -> tuple[Reader, ...]:
    """All reader modules, in the order in which they are tried."""
    return tuple(cast(Reader, import_module(f"{__name__}.{name}")) for name in _MODULES)


def open_product(path: str | Path) -> Product:
    """Open the product at `path`: a metadata file, an image with an RPC, or a product's folder.

    Raises a `ProductError` that names the file and the tag where something is wrong, and an
    `UnsupportedError` where no reader knows the file.
    """
    path = Path(path)
    if path.is_dir():
        return _open_folder(path)
    if not path.exists():
        raise MissingFileError(path, "", "there is no such file")
    source = Source.of(path)
    for reader in readers():
        if reader.recognises(source):
            return reader.read(source)
    formats = ", ".join(reader.FORMAT for reader in readers())
    raise UnsupportedError(path, "", f"a product expected, of one of these formats: {formats}")


def _open_folder(folder: Path) -> Product:
    for reader in readers():
        for pattern in reader.CANDIDATES:
            found = [
                source
                for source in map(Source.of, sorted(_files(folder, pattern)))
                if reader.recognises(source)
            ]
            if len(found) == 1:
                return reader.read(found[0])
            if found:
                names = ", ".join(str(source.path.relative_to(folder)) for source in found[:4])
                more = ", ..." if len(found) > 4 else ""
                raise ProductError(
                    folder,
                    "",
                    f"one product expected, {len(found)} found ({names}{more}): name one",
                )
    raise UnsupportedError(folder, "", "a folder with a product expected, none found in it")


def _files(folder: Path, pattern: str) -> list[Path]:
    return [path for path in folder.glob(pattern) if path.is_file() and path.stat().st_size]
