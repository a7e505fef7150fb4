"""`Global_RFM` of the Pleiades system DIMAP (`PHRDIMAP_*.XML`): functions of 40 numbers each.

`F_ROW` and `F_COL` (inverse), `F_LON` and `F_LAT` (direct) list a numerator's 20 coefficients,
then its denominator's; `A` is the scale and `B` the offset of each coordinate. Pixels: 1-based
in the file, 0-based in the model. Heights: metres above the WGS 84 ellipsoid. *Source*: the
order of arguments (column before row) was checked against the inverse functions.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from geoposition.errors import ProductError
from geoposition.rpc.direct import DirectRpc
from geoposition.rpc.formats import _fields as fields
from geoposition.rpc.formats._files import write_text
from geoposition.rpc.formats._xml import Tree, number, once, optional_pair, render, zero_based
from geoposition.rpc.formats.dimap import read_validity
from geoposition.rpc.model import RpcModel
from geoposition.xmlfile import XmlNode, read_xml

ROOT = "PHR_Dimap_Document"

_AXES = {
    "Lon": ("lon_off_deg", "lon_scale_deg"),
    "Lat": ("lat_off_deg", "lat_scale_deg"),
    "Alt": ("height_off_m", "height_scale_m"),
    "Col": ("samp_off_px", "samp_scale_px"),
    "Row": ("line_off_px", "line_scale_px"),
}


def read(path: Path) -> RpcModel:
    """Read an RPC; every miss is a `ProductError` naming the tag."""
    root = read_xml(path)
    rfm = root.need("Geoposition/Rational_Sensor_Model/Global_RFM")
    inverse, validity = once(rfm, "Inverse_Model"), once(rfm, "RFM_Validity")
    values: dict[str, Any] = {}
    places: dict[str, str] = {}
    for axis, (off, scale) in _AXES.items():
        node = once(validity, axis)
        values[off] = (zero_based if axis in ("Col", "Row") else number)(node, "B")
        values[scale] = number(node, "A")
        places |= {off: f"{node.place}/B", scale: f"{node.place}/A"}
    values["line_num"], values["line_den"] = _function(inverse, "F_ROW")
    values["samp_num"], values["samp_den"] = _function(inverse, "F_COL")
    values["fit_error_px"] = optional_pair(inverse, "MODEL_PRECISION_ROW", "MODEL_PRECISION_COL")
    direct = rfm.find("Direct_Model")
    if direct is not None:
        lon_num, lon_den = _function(direct, "F_LON")
        lat_num, lat_den = _function(direct, "F_LAT")
        precision = optional_pair(direct, "MODEL_PRECISION_X", "MODEL_PRECISION_Y")
        values["direct"] = DirectRpc(lon_num, lon_den, lat_num, lat_den, precision)
    values["validity"] = read_validity(validity)
    size = root.find("Raster_Dimensions")
    if size is not None:
        shape = size.integer("NROWS"), size.integer("NCOLS")
        if min(shape) < 1:
            raise ProductError(path, size.place, "a positive image size expected")
        values["image_shape"] = shape
    return fields.build(path, places.__getitem__, values)


def _function(node: XmlNode, tag: str) -> tuple[Any, Any]:
    numbers = once(node, tag).numbers(40)
    return numbers[:20], numbers[20:]


def write(model: RpcModel, path: Path) -> None:
    """Write the part of the dialect that is the RPC, at full precision."""

    def listed(num: Any, den: Any) -> str:
        return " ".join(map(repr, [*num.tolist(), *den.tolist()]))

    inverse: dict[str, str | Tree] = {
        "F_COL": listed(model.samp_num, model.samp_den),
        "F_ROW": listed(model.line_num, model.line_den),
    }
    if model.fit_error_px is not None:
        row, col = map(repr, model.fit_error_px)
        inverse |= {"MODEL_PRECISION_ROW": row, "MODEL_PRECISION_COL": col}
    rfm: dict[str, str | Tree] = {}
    if model.direct is not None:
        direct: dict[str, str | Tree] = {
            "F_LON": listed(model.direct.lon_num, model.direct.lon_den),
            "F_LAT": listed(model.direct.lat_num, model.direct.lat_den),
        }
        if model.direct.fit_error_m is not None:
            x, y = map(repr, model.direct.fit_error_m)
            direct |= {"MODEL_PRECISION_X": x, "MODEL_PRECISION_Y": y}
        rfm["Direct_Model"] = direct
    rfm["Inverse_Model"] = inverse
    validity: dict[str, str | Tree] = {}
    for axis, (off, scale) in _AXES.items():
        as_text = fields.to_one_based if axis in ("Col", "Row") else repr
        validity[axis] = {"A": repr(getattr(model, scale)), "B": as_text(getattr(model, off))}
    rfm["RFM_Validity"] = validity
    document: dict[str, str | Tree] = {
        "Geoposition": {"Rational_Sensor_Model": {"Global_RFM": rfm}},
    }
    if model.image_shape is not None:
        lines, samples = map(str, model.image_shape)
        document["Raster_Dimensions"] = {"NROWS": lines, "NCOLS": samples}
    write_text(path, render(ROOT, document, fields.PIXEL_ORIGIN_DIMAP))
