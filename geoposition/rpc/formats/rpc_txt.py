"""`_RPC.TXT`: one `KEY: value unit` per line (IKONOS, GeoEye, Planet, GDAL).

Pixels: 0-based, first pixel's centre at (0, 0). Heights: metres above the WGS 84 ellipsoid.
The image size is not in the file. *Source*: STDI-0002 vol. 1 appendix E; GDAL RFC 22.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from geoposition.errors import ProductError
from geoposition.rpc.formats import _fields as fields
from geoposition.rpc.formats._files import read_text, write_text
from geoposition.rpc.model import RpcModel

_LINE = re.compile(r"^\s*(\w+)\s*[:=]\s*(.*?)\s*$")
_UNITS = {"px": "pixels", "deg": "degrees", "m": "meters"}


def recognises(text: str) -> bool:
    """Tell whether `text` is of this dialect."""
    return re.search(r"^\s*(LINE_NUM_COEFF(_\d+)?|LINE_OFF)\s*[:=]", text, re.M) is not None


def read(path: Path) -> RpcModel:
    """Read an RPC; every miss is a `ProductError` naming the key."""
    texts: dict[str, str] = {}
    for line in read_text(path).splitlines():
        match = _LINE.match(line)
        if match is None:
            continue
        key = match[1].upper()
        if key in texts:
            raise ProductError(path, key, "this key is given twice")
        texts[key] = match[2]
    entries = fields.Entries(path, texts)
    values: dict[str, Any] = {
        field: entries.number(key) for key, field in fields.SCALAR_FIELDS.items()
    }
    for key, field in fields.COEFFICIENT_FIELDS.items():
        if key in texts:
            values[field] = fields.twenty_numbers(path, key, texts[key].replace(",", " ").split())
        else:
            values[field] = [entries.number(f"{key}_{i}") for i in range(1, 21)]
        if f"{key}_21" in texts:
            raise ProductError(path, f"{key}_21", "20 coefficients expected, there are more")
    for key, field in fields.ERROR_FIELDS.items():
        value = entries.optional(key)
        # GDAL writes -1 for an error that is not known.
        values[field] = None if value is None or value < 0.0 else value
    names = {field: key for key, field in fields.SCALAR_FIELDS.items()}
    return fields.build(path, names.__getitem__, values)


def write(model: RpcModel, path: Path) -> None:
    """Write `model`, at full precision."""
    lines = []
    for key, field in fields.SCALAR_FIELDS.items():
        lines.append(f"{key}: {getattr(model, field)!r} {_UNITS[field.rpartition('_')[2]]}")
    for key, field in fields.COEFFICIENT_FIELDS.items():
        coefficients = getattr(model, field).tolist()
        lines += [f"{key}_{i}: {value!r}" for i, value in enumerate(coefficients, start=1)]
    for key, field in fields.ERROR_FIELDS.items():
        if getattr(model, field) is not None:
            lines.append(f"{key}: {getattr(model, field)!r} meters")
    lines += [f"PIXEL_ORIGIN: {fields.PIXEL_ORIGIN}", f"HEIGHT_DATUM: {fields.HEIGHT_DATUM}"]
    write_text(path, "\n".join(lines) + "\n")
