"""DIMAP version 2 `RPC_*.XML` of Pleiades and SPOT 6/7, inverse and direct coefficients.

Pixels: 1-based in the file (the first pixel's centre is (1, 1)), 0-based in the model. The
inverse coefficients are the model; the direct ones, where present, come along as
`RpcModel.direct`. Heights: metres above the WGS 84 ellipsoid. The file states where the
coefficients were fitted, which may be more than the image, so the image size is not known.
*Source*: Pleiades Imagery User Guide (Airbus), appendix on RPC products.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from geoposition.errors import ArgumentError, ProductError
from geoposition.rpc.direct import DirectRpc
from geoposition.rpc.formats import _fields as fields
from geoposition.rpc.formats._files import write_text
from geoposition.rpc.formats._xml import (
    Tree,
    number,
    once,
    optional_pair,
    render,
    zero_based,
)
from geoposition.rpc.model import RpcModel, RpcValidity
from geoposition.xmlfile import XmlNode, read_xml

ROOT = "Dimap_Document"

_DIRECT = {
    "lon_num": "SAMP_NUM_COEFF",
    "lon_den": "SAMP_DEN_COEFF",
    "lat_num": "LINE_NUM_COEFF",
    "lat_den": "LINE_DEN_COEFF",
}
_DOMAINS = {
    "line_px": ("Direct_Model_Validity_Domain", "FIRST_ROW", "LAST_ROW"),
    "samp_px": ("Direct_Model_Validity_Domain", "FIRST_COL", "LAST_COL"),
    "lon_deg": ("Inverse_Model_Validity_Domain", "FIRST_LON", "LAST_LON"),
    "lat_deg": ("Inverse_Model_Validity_Domain", "FIRST_LAT", "LAST_LAT"),
}


def read(path: Path) -> RpcModel:
    """Read an RPC; every miss is a `ProductError` naming the tag."""
    root = read_xml(path)
    if root.find("Rational_Function_Model") is None:
        raise ProductError(
            path, f"{root.place}/Rational_Function_Model",
            "this tag is missing: the RPC of a DIMAP product is in its RPC_*.XML file",
        )  # fmt: skip
    rfm = once(once(root, "Rational_Function_Model"), "Global_RFM")
    inverse = once(rfm, "Inverse_Model")
    validity = once(rfm, "RFM_Validity")
    values: dict[str, Any] = {}
    for key, field in fields.SCALAR_FIELDS.items():
        one_based = key in ("LINE_OFF", "SAMP_OFF")
        values[field] = (zero_based if one_based else number)(validity, key)
    for key, field in fields.COEFFICIENT_FIELDS.items():
        values[field] = _coefficients(inverse, key)
    values["fit_error_px"] = optional_pair(inverse, "ERR_BIAS_ROW", "ERR_BIAS_COL")
    values["direct"] = _direct(rfm)
    values["validity"] = read_validity(validity)
    names = {field: f"{validity.place}/{key}" for key, field in fields.SCALAR_FIELDS.items()}
    return fields.build(path, names.__getitem__, values)


def _coefficients(node: XmlNode, key: str) -> list[float]:
    if node.find(f"{key}_21") is not None:
        raise ProductError(
            node.path, f"{node.place}/{key}_21", "20 coefficients expected, there are more"
        )
    return [number(node, f"{key}_{i}") for i in range(1, 21)]


def _direct(rfm: XmlNode) -> DirectRpc | None:
    node = rfm.find("Direct_Model")
    if node is None:
        return None
    parts: dict[str, Any] = {name: _coefficients(node, key) for name, key in _DIRECT.items()}
    try:
        return DirectRpc(**parts, fit_error_m=optional_pair(node, "ERR_BIAS_X", "ERR_BIAS_Y"))
    except ArgumentError as error:
        raise ProductError(node.path, node.place, str(error)) from None


def read_validity(node: XmlNode) -> RpcValidity | None:
    """Read where the coefficients were fitted, or None where the file does not say all of it."""
    ranges: dict[str, tuple[float, float]] = {}
    for name, (domain, first, last) in _DOMAINS.items():
        found = node.find(domain)
        if found is None or found.find(first) is None or found.find(last) is None:
            return None
        take = zero_based if name.endswith("_px") else number
        ranges[name] = take(found, first), take(found, last)
    return RpcValidity(**ranges)


def write(model: RpcModel, path: Path) -> None:
    """Write `model`, at full precision; what it does not know is left out.

    The dialect has no place for `err_bias_m` and `err_rand_m`, nor for the image size.
    """
    inverse: dict[str, str | Tree] = {}
    for key, field in fields.COEFFICIENT_FIELDS.items():
        inverse |= _tags(key, getattr(model, field).tolist())
    if model.fit_error_px is not None:
        inverse["ERR_BIAS_ROW"], inverse["ERR_BIAS_COL"] = map(repr, model.fit_error_px)
    rfm: dict[str, str | Tree] = {}
    if model.direct is not None:
        direct: dict[str, str | Tree] = {}
        for name, key in _DIRECT.items():
            direct |= _tags(key, getattr(model.direct, name).tolist())
        if model.direct.fit_error_m is not None:
            direct["ERR_BIAS_X"], direct["ERR_BIAS_Y"] = map(repr, model.direct.fit_error_m)
        rfm["Direct_Model"] = direct
    rfm["Inverse_Model"] = inverse
    rfm["RFM_Validity"] = _validity_tags(model)
    document: Tree = {
        "Metadata_Identification": {
            'METADATA_FORMAT version="2.0"': "DIMAP",
            "METADATA_PROFILE": "SENSOR",
            "METADATA_SUBPROFILE": "RPC",
            "METADATA_LANGUAGE": "en",
        },
        "Rational_Function_Model": {
            "Resource_Reference": {
                'RESOURCE_TITLE version="2.1"': "NITF",
                "RESOURCE_ID": "RPC00B",
            },
            "Global_RFM": rfm,
        },
    }
    write_text(path, render(ROOT, document, fields.PIXEL_ORIGIN_DIMAP))


def _tags(key: str, coefficients: list[float]) -> dict[str, str | Tree]:
    return {f"{key}_{i}": repr(value) for i, value in enumerate(coefficients, start=1)}


def _validity_tags(model: RpcModel) -> Tree:
    tags: dict[str, str | Tree] = {}
    if model.validity is not None:
        domains: dict[str, dict[str, str | Tree]] = {}
        for name, (domain, first, last) in _DOMAINS.items():
            as_text = fields.to_one_based if name.endswith("_px") else repr
            low, high = getattr(model.validity, name)
            domains.setdefault(domain, {}).update({first: as_text(low), last: as_text(high)})
        tags |= domains
    for key, field in fields.SCALAR_FIELDS.items():
        as_text = fields.to_one_based if key in ("LINE_OFF", "SAMP_OFF") else repr
        tags[key] = as_text(getattr(model, field))
    return tags
