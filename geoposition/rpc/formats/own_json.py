"""Our own JSON: every field of an `RpcModel` by name, at full precision.

Pixels: 0-based, first pixel's centre at (0, 0). Heights: metres above the WGS 84 ellipsoid.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from geoposition.errors import ArgumentError, ProductError, UnsupportedError
from geoposition.rpc.direct import DirectRpc
from geoposition.rpc.formats._fields import HEIGHT_DATUM, PIXEL_ORIGIN, build
from geoposition.rpc.formats._files import read_text, write_text
from geoposition.rpc.model import RpcModel, RpcValidity

FORMAT = "geoposition-rpc"
VERSION = 1

_STATEMENTS = {"pixel_origin": PIXEL_ORIGIN, "height_datum": HEIGHT_DATUM}

_FIELDS = [field.name for field in fields(RpcModel) if field.init]
_TEXTS = {"satellite", "band"}
_LISTS = {"line_num": 20, "line_den": 20, "samp_num": 20, "samp_den": 20}
_PAIRS = {"image_shape": 2, "fit_error_px": 2}
_DIRECT = {"lon_num": 20, "lon_den": 20, "lat_num": 20, "lat_den": 20, "fit_error_m": 2}
_VALIDITY = {"line_px": 2, "samp_px": 2, "lon_deg": 2, "lat_deg": 2}
_REQUIRED = {*_LISTS} | {f"{a}_{b}" for a, u in
             (("line", "px"), ("samp", "px"), ("lon", "deg"), ("lat", "deg"), ("height", "m"))
             for b in (f"off_{u}", f"scale_{u}")}  # fmt: skip


def read(path: Path) -> RpcModel:
    """Read an RPC; every miss is a `ProductError` naming the key."""

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, value in pairs:
            if key in found:
                raise ProductError(path, key, "this key is given twice")
            found[key] = value
        return found

    try:
        document = json.loads(read_text(path), object_pairs_hook=unique)
    except json.JSONDecodeError as error:
        raise ProductError(
            path, f"line {error.lineno}, column {error.colno}", f"JSON expected ({error.msg})"
        ) from None
    except RecursionError:
        raise ProductError(path, "", "JSON expected, this is nested too deeply") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise ProductError(path, "format", f'"{FORMAT}" expected')
    if document.get("version") != VERSION:
        raise UnsupportedError(path, "version", f"{VERSION} expected")
    values: dict[str, Any] = {}
    for name in _FIELDS:
        value = document.get(name)
        if value is None:
            if name in _REQUIRED:
                raise ProductError(path, name, "this key is missing")
            continue
        values[name] = _checked(path, name, value)
    return build(path, str, values)


def _checked(path: Path, name: str, value: object) -> object:
    """Turn one entry of the document into what `RpcModel` takes."""
    if name in _TEXTS:
        if not isinstance(value, str):
            raise ProductError(path, name, "a text expected")
        return value
    if name == "direct":
        parts = _parts(path, name, value, _DIRECT, optional="fit_error_m")
        try:
            return DirectRpc(**parts)
        except ArgumentError as error:
            raise ProductError(path, name, str(error)) from None
    if name == "validity":
        return RpcValidity(**_parts(path, name, value, _VALIDITY))
    if name in _LISTS:
        return _numbers(path, name, value, _LISTS[name])
    if name == "image_shape":
        shape = _numbers(path, name, value, 2)
        if any(n != int(n) or n < 1 for n in shape):
            raise ProductError(path, name, "whole, positive numbers expected")
        return int(shape[0]), int(shape[1])
    if name in _PAIRS:
        return tuple(_numbers(path, name, value, 2))
    return _numbers(path, name, [value], 1)[0]


def _parts(
    path: Path, name: str, value: object, sizes: dict[str, int], optional: str = ""
) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ProductError(path, name, "an object expected")
    parts: dict[str, Any] = {}
    for key, size in sizes.items():
        if value.get(key) is None:
            if key == optional:
                continue
            raise ProductError(path, f"{name}.{key}", "this key is missing")
        numbers = _numbers(path, f"{name}.{key}", value[key], size)
        parts[key] = tuple(numbers) if size == 2 else np.array(numbers)
    return parts


def _numbers(path: Path, place: str, value: object, size: int) -> list[float]:
    if not isinstance(value, list) or len(value) != size:
        got = len(value) if isinstance(value, list) else type(value).__name__
        raise ProductError(path, place, f"{size} number(s) expected, got {got}")
    for item in value:
        if isinstance(item, bool) or not isinstance(item, int | float) or not math.isfinite(item):
            raise ProductError(path, place, f"finite number(s) expected, got {item!r}"[:80])
    return [float(item) for item in value]


def write(model: RpcModel, path: Path) -> None:
    """Write `model`, with all it carries, at full precision."""
    document: dict[str, Any] = {"format": FORMAT, "version": VERSION, **_STATEMENTS}
    for name in _FIELDS:
        value = getattr(model, name)
        if name in ("direct", "validity") and value is not None:
            value = {key: _plain(item) for key, item in asdict(value).items()}
        document[name] = _plain(value)
    write_text(path, json.dumps(document, indent=1) + "\n")


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
