"""`isd/RPB` in the support data XML of WorldView and GeoEye (DigitalGlobe, Maxar).

Pixels: 0-based, first pixel's centre at (0, 0). Heights: metres above the WGS 84 ellipsoid.
The image size is in `isd/IMD`. *Source*: DigitalGlobe Imagery Support Data, XML form.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from geoposition.errors import ProductError
from geoposition.rpc.formats import _fields as fields
from geoposition.rpc.formats import rpb
from geoposition.rpc.formats._files import write_text
from geoposition.rpc.formats._xml import Tree, number, once, optional_number, render
from geoposition.rpc.model import RpcModel
from geoposition.xmlfile import XmlNode, read_xml

ROOT = "isd"


def read(path: Path) -> RpcModel:
    """Read an RPC; every miss is a `ProductError` naming the tag."""
    root = read_xml(path)
    group = once(root, "RPB")
    spec = group.find("SPECID")
    if spec is not None:
        rpb.require_rpc00b(path, spec.place, spec.text())
    image = once(group, "IMAGE")
    values: dict[str, Any] = {
        field: number(image, key.upper()) for key, field in rpb.SCALARS.items()
    }
    for key, field in rpb.COEFFICIENTS.items():
        values[field] = _coefficients(image, key.upper())
    for key, field in rpb.ERRORS.items():
        values[field] = optional_number(image, key.upper())
    for key, field in (("SATID", "satellite"), ("BANDID", "band")):
        node = group.find(key)
        values[field] = "" if node is None else (node.element.text or "").strip()
    imd = root.find("IMD")
    if imd is not None and imd.find("NUMROWS") and imd.find("NUMCOLUMNS"):
        shape = imd.integer("NUMROWS"), imd.integer("NUMCOLUMNS")
        if min(shape) < 1:
            raise ProductError(path, f"{imd.place}/NUMROWS", "a positive image size expected")
        values["image_shape"] = shape
    names = {field: f"{image.place}/{key.upper()}" for key, field in rpb.SCALARS.items()}
    return fields.build(path, names.__getitem__, values)


def _coefficients(image: XmlNode, key: str) -> list[float]:
    holder = once(image, f"{key}List")
    words = [word for node in holder.some(key) for word in node.text().replace(",", " ").split()]
    return fields.twenty_numbers(image.path, f"{holder.place}/{key}", words)


def write(model: RpcModel, path: Path) -> None:
    """Write the part of the dialect that is the RPC, at full precision."""
    image: dict[str, str | Tree] = {}
    for key, field in rpb.ERRORS.items():
        if getattr(model, field) is not None:
            image[key.upper()] = repr(getattr(model, field))
    image |= {key.upper(): repr(getattr(model, field)) for key, field in rpb.SCALARS.items()}
    for key, field in rpb.COEFFICIENTS.items():
        numbers = " ".join(map(repr, getattr(model, field).tolist()))
        image[f"{key.upper()}List"] = {key.upper(): numbers}
    document: dict[str, str | Tree] = {}
    if model.image_shape is not None:
        lines, samples = map(str, model.image_shape)
        document["IMD"] = {"NUMROWS": lines, "NUMCOLUMNS": samples}
    document["RPB"] = {
        "SATID": model.satellite,
        "BANDID": model.band,
        "SPECID": "RPC00B",
        "IMAGE": image,
    }
    write_text(path, render(ROOT, document, fields.PIXEL_ORIGIN))
