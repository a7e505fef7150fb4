"""The files a DIMAP product consists of: volume, metadata, RPC, image tiles."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from geoposition.errors import MissingFileError, UnsupportedError
from geoposition.named_files import is_there
from geoposition.xmlfile import XmlNode


def referred_file(node: XmlNode) -> Path | None:
    """File that the `href` of `node` (or its text) names, below its own folder; else None."""
    href = (node.element.get("href") or node.element.text or "").strip()
    relative = PurePosixPath(href.replace("\\", "/"))
    if not href or relative.is_absolute() or ".." in relative.parts:
        return None
    path = node.path.parent / relative
    return path if is_there(path) else None


def volume_images(volume: XmlNode) -> list[Path]:
    """Metadata files of the images of a volume, panchromatic first; at least one."""
    components = volume.some("Dataset_Content/Dataset_Components/Component")
    hrefs, found = [], []
    for component in components:
        node = component.find("COMPONENT_PATH")
        name = "" if node is None else PurePosixPath(node.element.get("href") or "").name
        if node is None or not (name.upper().startswith("DIM_") and name.upper().endswith(".XML")):
            continue
        hrefs.append(name)
        path = referred_file(node)
        if path is not None:
            found.append(path)
    if not hrefs:
        raise UnsupportedError(
            volume.path, components[0].place, "a volume with DIM_*.XML components expected"
        )
    if not found:
        raise MissingFileError(
            volume.path, "Dataset_Components", f"none of its images is there ({', '.join(hrefs)})"
        )
    return sorted(found, key=lambda path: "_P_" not in path.name.upper())


def rpc_file(product: XmlNode) -> tuple[Path | None, str | None]:
    """RPC file the product refers to, where it is there; else None and a note."""
    nodes = product.all("Geoposition/Geoposition_Models/Rational_Function_Model/Component")
    named = None
    for component in nodes:
        node = component.find("COMPONENT_PATH")
        if node is not None:
            path = referred_file(node)
            if path is not None:
                return path, None
            named = node.element.get("href")
    if named is None:
        return None, "the product names no RPC file"
    return None, f"its RPC file {named} is not there"


def image_file(files: list[XmlNode], metadata: Path) -> tuple[Path | None, list[str]]:
    """Image as one readable file, and notes: a tiled image is read through its metadata.

    `files` are the DATA_FILE_PATH nodes. GDAL opens the metadata file of a DIMAP product as the
    mosaic of its tiles.
    """
    paths = [referred_file(node) for node in files]
    if not paths or any(path is None for path in paths):
        return None, []
    if len(paths) == 1:
        return paths[0], []
    return metadata, [f"image in {len(paths)} tiles, read through its metadata file"]
