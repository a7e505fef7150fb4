"""`.geom`: the keyword list of OSSIM and of the Orfeo ToolBox before version 8.

Pixels: 0-based, first pixel's centre at (0, 0) (checked: the list of a Pleiades scene has
`line_off` one less than the scene's 1-based DIMAP file). The coefficients are those of the
whole image, also beside a crop. Heights: metres above the WGS 84 ellipsoid. *Source*: OSSIM,
ossimRpcModel::saveState.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from geoposition.errors import ProductError, UnsupportedError
from geoposition.rpc.formats import _fields as fields
from geoposition.rpc.formats._files import read_text, write_text
from geoposition.rpc.model import RpcModel

_LINE = re.compile(r"^\s*([\w.]+):\s*(.*?)\s*$")
_ERRORS = {"bias_error": "err_bias_m", "rand_error": "err_rand_m"}
_ADJUSTED = re.compile(r"adjustment_\d+\.adj_param_\d+\.(center|parameter)$")


def recognises(text: str) -> bool:
    """Tell whether `text` is of this dialect."""
    return re.search(r"^\s*(line_num_coeff_\d\d|polynomial_format)\s*:", text, re.M) is not None


def read(path: Path) -> RpcModel:
    """Read an RPC; every miss is a `ProductError` naming the key."""
    texts: dict[str, str] = {}
    for line in read_text(path).splitlines():
        match = _LINE.match(line)
        if match is None:
            continue
        if match[1] in texts:
            raise ProductError(path, match[1], "this key is given twice")
        texts[match[1]] = match[2]
    entries = fields.Entries(path, texts)
    if entries.text("polynomial_format").upper() != "B":
        raise UnsupportedError(path, "polynomial_format", "B (RPC00B order) expected")
    for key in texts:
        if _ADJUSTED.match(key) and entries.number(key) != 0.0:
            raise UnsupportedError(path, key, "0 expected: adjusted models cannot be used")
    values: dict[str, Any] = {
        field: entries.number(key.lower()) for key, field in fields.SCALAR_FIELDS.items()
    }
    for key, field in fields.COEFFICIENT_FIELDS.items():
        stem = key.lower()
        values[field] = [entries.number(f"{stem}_{i:02d}") for i in range(20)]
        if f"{stem}_20" in texts:
            raise ProductError(path, f"{stem}_20", "20 coefficients expected, there are more")
    for key, field in _ERRORS.items():
        # 0 stands for an error that is not known.
        values[field] = entries.optional(key) or None
    if "number_lines" in texts and "number_samples" in texts:
        shape = entries.number("number_lines"), entries.number("number_samples")
        if min(shape) < 1 or any(n != int(n) for n in shape):
            raise ProductError(path, "number_lines", "a whole, positive image size expected")
        values["image_shape"] = int(shape[0]), int(shape[1])
    values["satellite"] = texts.get("sensor", "")
    names = {field: key.lower() for key, field in fields.SCALAR_FIELDS.items()}
    return fields.build(path, names.__getitem__, values)


def write(model: RpcModel, path: Path) -> None:
    """Write `model`, at full precision, as an ossimRpcModel."""
    texts = {"type": "ossimRpcModel", "polynomial_format": "B"}
    texts |= {"pixel_origin": fields.PIXEL_ORIGIN, "height_datum": fields.HEIGHT_DATUM}
    texts["sensor"] = model.satellite or "unknown"
    for key, field in fields.SCALAR_FIELDS.items():
        texts[key.lower()] = repr(getattr(model, field))
    for key, field in fields.COEFFICIENT_FIELDS.items():
        for i, value in enumerate(getattr(model, field).tolist()):
            texts[f"{key.lower()}_{i:02d}"] = repr(value)
    for key, field in _ERRORS.items():
        texts[key] = repr(getattr(model, field) or 0)
    if model.image_shape is not None:
        lines, samples = model.image_shape
        texts |= {"number_lines": str(lines), "number_samples": str(samples)}
        texts["rect"] = f"0 0 {samples - 1} {lines - 1}"
    write_text(path, "".join(f"{key}:  {texts[key]}\n" for key in sorted(texts)))
