"""`.RPB`: the text form of DigitalGlobe and Maxar, `key = value;` with lists in parentheses.

Pixels: 0-based, first pixel's centre at (0, 0). Heights: metres above the WGS 84 ellipsoid.
The image size is not in the file. *Source*: DigitalGlobe Imagery Support Data, RPB file.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from geoposition.errors import ProductError, UnsupportedError
from geoposition.rpc.formats import _fields as fields
from geoposition.rpc.formats._files import read_text, write_text
from geoposition.rpc.model import RpcModel

SCALARS = {
    "lineOffset": "line_off_px",
    "sampOffset": "samp_off_px",
    "latOffset": "lat_off_deg",
    "longOffset": "lon_off_deg",
    "heightOffset": "height_off_m",
    "lineScale": "line_scale_px",
    "sampScale": "samp_scale_px",
    "latScale": "lat_scale_deg",
    "longScale": "lon_scale_deg",
    "heightScale": "height_scale_m",
}
COEFFICIENTS = {
    "lineNumCoef": "line_num",
    "lineDenCoef": "line_den",
    "sampNumCoef": "samp_num",
    "sampDenCoef": "samp_den",
}
ERRORS = {"errBias": "err_bias_m", "errRand": "err_rand_m"}

_ENTRY = re.compile(r"(\w+)\s*=\s*(\([^()=]*\)?|\"[^\"\n]*\"?|[^;\s]*)")


def recognises(text: str) -> bool:
    """Tell whether `text` is of this dialect."""
    return re.search(r"\blineOffset\s*=|\blineNumCoef\s*=", text, re.I) is not None


def read(path: Path) -> RpcModel:
    """Read an RPC; quoting, line breaks and semicolons may vary, keys in any letter case."""
    names = {key.lower(): key for key in (*SCALARS, *COEFFICIENTS, *ERRORS)}
    texts: dict[str, str] = {}
    for match in _ENTRY.finditer(read_text(path)):
        key = names.get(match[1].lower(), match[1].lower())
        if key in ("begin_group", "end_group"):
            continue
        if key in texts:
            raise ProductError(path, key, "this key is given twice")
        texts[key] = match[2].strip().strip('"').strip()
    entries = fields.Entries(path, texts)
    require_rpc00b(path, "SpecId", texts.get("specid", "RPC00B"))
    values: dict[str, Any] = {field: entries.number(key) for key, field in SCALARS.items()}
    for key, field in COEFFICIENTS.items():
        text = entries.text(key)
        if not (text.startswith("(") and text.endswith(")")):
            raise ProductError(path, key, "a list in parentheses expected")
        words = text[1:-1].replace(",", " ").replace('"', " ").split()
        values[field] = fields.twenty_numbers(path, key, words)
    for key, field in ERRORS.items():
        values[field] = entries.optional(key)
    values |= {"satellite": texts.get("satid", ""), "band": texts.get("bandid", "")}
    return fields.build(path, {f: k for k, f in SCALARS.items()}.__getitem__, values)


def require_rpc00b(path: Path, place: str, spec: str) -> None:
    """Refuse another order of the coefficients than RPC00B."""
    if spec.upper() != "RPC00B":
        raise UnsupportedError(path, place, f"coefficients in RPC00B order expected, not {spec}")


def write(model: RpcModel, path: Path) -> None:
    """Write `model`, at full precision."""
    lines = [
        f'satId = "{model.satellite or "????"}";',
        f'bandId = "{model.band or "?"}";',
        'SpecId = "RPC00B";',
        "BEGIN_GROUP = IMAGE",
    ]
    for key, field in ERRORS.items():
        if getattr(model, field) is not None:
            lines.append(f"\t{key} = {getattr(model, field)!r};")
    lines += [f"\t{key} = {getattr(model, field)!r};" for key, field in SCALARS.items()]
    for key, field in COEFFICIENTS.items():
        numbers = ",\n".join(f"\t\t\t{value!r}" for value in getattr(model, field).tolist())
        lines.append(f"\t{key} = (\n{numbers});")
    lines += ["END_GROUP = IMAGE", "END;"]
    # behind the end, where no parser looks
    lines += [f"/* Pixels: {fields.PIXEL_ORIGIN}. Heights: {fields.HEIGHT_DATUM}. */", ""]
    write_text(path, "\n".join(lines))
