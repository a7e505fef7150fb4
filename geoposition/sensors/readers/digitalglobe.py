"""Reader of DigitalGlobe / Maxar support data: WorldView-1 to -4, GeoEye-1, QuickBird-2.

Two forms of the same data are read: one XML (`isd`), or a set of text files .IMD, .EPH, .ATT,
.GEO, .RPB, .TIL of one stem. Basic products (level 1B) give the rigorous model; ortho-ready ones
(2A) were resampled to the ground, and their RPC is the model.

The model's image is the whole one, NUMROWS by NUMCOLUMNS, as the RPC's is: a pixel of a tile
lies at its own coordinates plus the tile's offsets, which `details` lists.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from geoposition.errors import MissingFileError, ProductError, UnsupportedError
from geoposition.named_files import is_there
from geoposition.product import Product
from geoposition.rpc.formats import read_rpc
from geoposition.rpc.model import RpcModel
from geoposition.sensor_model import SensorModel
from geoposition.sensors.readers.digitalglobe_image import SATELLITES, UNVERIFIED, parse_image
from geoposition.sensors.readers.digitalglobe_model import build_model, sigma_summary
from geoposition.sensors.readers.digitalglobe_support import (
    Support,
    parse_attitude,
    parse_camera,
    parse_ephemeris,
)
from geoposition.sensors.readers.digitalglobe_tree import Group, read_text_tree, read_xml_tree

if TYPE_CHECKING:
    from geoposition.sensors.readers.source import Source

FORMAT = "DigitalGlobe ISD"

CANDIDATES = (
    "*.XML",
    "*.xml",
    "*.IMD",
    "*.imd",
    "**/*_P[0-9][0-9][0-9].XML",
    "**/*_P[0-9][0-9][0-9].xml",
    "**/*.IMD",
    "**/*.imd",
)

_TEXT_MARK = re.compile(
    rb"\b(numRows\s*=|ephemList\s*=|attList\s*=|geoModelLevel\s*=|BEGIN_GROUP\s*=\s*TILE_1\b)",
    re.IGNORECASE,
)
_GROUP_FILES = ("EPH", "ATT", "GEO")
_IMAGE_SUFFIXES = (".TIF", ".tif", ".TIFF", ".tiff", ".NTF", ".ntf")
_MAX_TILES = 10_000


def recognises(source: Source) -> bool:
    """Tell support data by content: root `isd`, or a key of one of the text files."""
    if source.xml_root is not None:
        return source.xml_root.lower() == "isd"
    return _TEXT_MARK.search(source.head) is not None


def read(source: Source) -> Product:
    """Read `source`: the XML, or any file of a text set but the .RPB.

    Raises
    ------
    ProductError
        Something is missing, malformed or contradictory; names the file and the tag.
    UnsupportedError
        The product is not for this toolkit: optical distortion, several detector arrays,
        several images, an unknown satellite, an ortho-ready level without RPC.
    """
    if source.xml_root is not None:
        return _product(*_from_xml(source.path))
    return _product(*_from_text(source.path))


def _from_xml(path: Path) -> tuple[Support, Path | None]:
    root = read_xml_tree(path)
    groups = {name: root.find(name) for name in _GROUP_FILES}
    if any(groups.values()):
        groups = {name: root.need(name) for name in _GROUP_FILES}
    support = _support(path, root.need("IMD"), groups, root.find("TIL"))
    return support, path if root.find("RPB") is not None else None


def _from_text(path: Path) -> tuple[Support, Path | None]:
    imd = _sibling(path, "IMD")
    if imd is None:
        raise MissingFileError(path.with_suffix(".IMD"), "", "this file of the set is missing")
    files = {name: _sibling(path, name) for name in _GROUP_FILES}
    groups: dict[str, Group | None] = dict.fromkeys(_GROUP_FILES)
    if any(files.values()):
        for name, file in files.items():
            if file is None:
                missing = path.with_suffix(f".{name}")
                raise MissingFileError(missing, "", "this file of the set is missing")
            groups[name] = read_text_tree(file)
    til = _sibling(path, "TIL")
    tiles = _tileset(read_text_tree(til)) if til is not None else None
    return _support(imd, read_text_tree(imd), groups, tiles), _sibling(path, "RPB")


def _tileset(tree: Group) -> Group:
    return tree.find("TILESET") or tree


def _sibling(path: Path, suffix: str) -> Path | None:
    """Find the file beside `path` with its stem and `suffix`, in whatever case."""
    for spelled in (suffix.upper(), suffix.lower()):
        candidate = path.with_suffix(f".{spelled}")
        if candidate.is_file():
            return candidate
    return None


def _support(path: Path, imd: Group, groups: dict[str, Group | None], til: Group | None) -> Support:
    image = parse_image(imd)
    if not image.is_raw_geometry:
        return Support(path, image, None, None, None, til)
    eph, att, geo = (groups[name] for name in _GROUP_FILES)
    if eph is None or att is None or geo is None:
        return Support(path, image, None, None, None, til)
    for group in (eph, att, geo):
        if group.text("satId").upper() != image.satellite:
            raise group.error("satId", f"{image.satellite} expected, as the image's is")
    return Support(
        path,
        image,
        parse_ephemeris(eph),
        parse_attitude(att),
        parse_camera(geo, image.band),
        til,
    )


def _product(support: Support, rpc_path: Path | None) -> Product:
    image = support.image
    rpc = read_rpc(rpc_path).with_shape(image.shape) if rpc_path is not None else None
    details: dict[str, object] = {
        "level": image.level,
        "descriptor": image.descriptor,
        "band": image.band,
        **image.facts,
    }
    if image.corners:
        details["corners_deg_m"] = {name: list(value) for name, value in image.corners.items()}
    notes = list(image.notes)
    if image.satellite in UNVERIFIED:
        notes.append(f"{SATELLITES[image.satellite]}: conventions as of its sister satellites")
    image_path = _tiles(support, details, notes)
    model: SensorModel
    if support.ephemeris and support.attitude and support.camera and image.timing:
        heights = _height_range(support, rpc)
        model = build_model(
            image, image.timing, support.ephemeris, support.attitude, support.camera, heights
        )
        details |= sigma_summary(support.ephemeris, support.attitude)
        notes += support.camera.notes
    elif rpc is not None:
        model = rpc
        notes.append(
            "camera, ephemeris and attitude do not come with this product: its RPC is the model"
            if image.is_raw_geometry
            else f"level {image.level} is resampled to the ground: its RPC is the model"
        )
    else:
        raise UnsupportedError(
            support.path,
            image.group.place_of("productLevel"),
            f"a Basic (1B) product with EPH, ATT and GEO, or an RPC, expected; got {image.level!r}",
        )
    if notes:
        details["notes"] = notes
    return Product(
        support.path,
        FORMAT,
        SATELLITES[image.satellite],
        model,
        rpc,
        image_path,
        image.start,
        details,
    )


def _height_range(support: Support, rpc: RpcModel | None) -> tuple[float, float]:
    """Return the RPC's range; without one the corners' heights with 500 m around, or any land."""
    if rpc is not None:
        return rpc.height_range_m
    heights = [height for _, _, height in support.image.corners.values() if height == height]
    if not heights:
        return -500.0, 9000.0
    return min(heights) - 500.0, max(heights) + 500.0


def _tiles(support: Support, details: dict[str, object], notes: list[str]) -> Path | None:
    """List the tiles, and find the image file: the only tile, or the file of the same stem."""
    folder, shape = support.path.parent, support.image.shape
    tiles = support.tiles.named("TILE") if support.tiles is not None else []
    if len(tiles) > _MAX_TILES:
        raise ProductError(support.path, tiles[0].place, f"at most {_MAX_TILES} tiles expected")
    listed = {}
    for tile in tiles:
        first = (tile.integer("ULRowOffset"), tile.integer("ULColOffset"))
        last = (tile.integer("LRRowOffset"), tile.integer("LRColOffset"))
        if not all(0 <= a <= b < n for a, b, n in zip(first, last, shape, strict=True)):
            raise tile.error("ULRowOffset", f"a tile inside the image {shape} expected")
        # A name only: a product must not point outside its own folder.
        listed[re.split(r"[\\/]", tile.text("filename"))[-1]] = [*first, *last]
    if len(listed) > 1:
        details["tiles_first_last_line_sample"] = listed
        notes.append("image coordinates are the whole image's: tile coordinates plus its offsets")
        return None
    names = [*listed, *(support.path.stem + suffix for suffix in _IMAGE_SUFFIXES)]
    return next((folder / name for name in names if is_there(folder / name)), None)
