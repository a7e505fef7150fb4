"""RPC files and images that carry an RPC, as products."""

from __future__ import annotations

from pathlib import Path

from geoposition.errors import ProductError
from geoposition.product import Product
from geoposition.rpc.formats import read_rpc, sniff
from geoposition.sensors.readers.source import Source

FORMAT = "RPC (RPB, _RPC.TXT, DIMAP, Maxar XML, .geom, JSON, GeoTIFF tag)"
CANDIDATES = (
    "*RPC*.[xX][mM][lL]",
    "*.[rR][pP][bB]",
    "*_[rR][pP][cC].[tT][xX][tT]",
    "*.geom",
    "*.[tT][iI][fF]",
)
_IMAGE_SUFFIXES = (".tif", ".TIF", ".tiff", ".TIFF", ".ntf", ".NTF", ".jp2", ".JP2")
_NAME_ENDS = ("_RPC", "_rpc")


def recognises(source: Source) -> bool:
    """Tell whether some dialect's reader takes the file for its own."""
    try:
        sniff(source.path)
    except ProductError:
        # The RPC formats say best what is wrong with a file that only they can hold.
        return source.path.suffix.lower() in {".rpb", ".geom"} or _named_rpc(source.path)
    return True


def _named_rpc(path: Path) -> bool:
    return "rpc" in path.stem.lower() and path.suffix.lower() in {".txt", ".xml"}


def read(source: Source) -> Product:
    """Read the RPC; the image is the file itself, or one of the same name beside it."""
    dialect = sniff(source.path)
    model = read_rpc(source.path)
    image = source.path if dialect == "geotiff" else _image_beside(source.path)
    return Product(
        path=source.path,
        format=f"RPC ({dialect})",
        sensor=model.satellite or "unknown",
        model=model,
        vendor_rpc=model,
        image_path=image,
    )


def _image_beside(path: Path) -> Path | None:
    stems = [path.stem, *(path.stem.removesuffix(end) for end in _NAME_ENDS)]
    stems += [path.stem.replace("RPC_", "IMG_", 1)]
    for stem in dict.fromkeys(stems):
        for suffix in _IMAGE_SUFFIXES:
            image = path.with_name(stem + suffix)
            if image.is_file():
                return image
    return None
