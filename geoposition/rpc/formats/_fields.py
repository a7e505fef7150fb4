"""What every dialect shares: named numbers in, an `RpcModel` or a `ProductError` out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal, InvalidOperation
from pathlib import Path
from typing import Any

from geoposition.errors import ArgumentError, ProductError
from geoposition.rpc.model import RpcModel

SCALAR_FIELDS = {
    "LINE_OFF": "line_off_px",
    "SAMP_OFF": "samp_off_px",
    "LAT_OFF": "lat_off_deg",
    "LONG_OFF": "lon_off_deg",
    "HEIGHT_OFF": "height_off_m",
    "LINE_SCALE": "line_scale_px",
    "SAMP_SCALE": "samp_scale_px",
    "LAT_SCALE": "lat_scale_deg",
    "LONG_SCALE": "lon_scale_deg",
    "HEIGHT_SCALE": "height_scale_m",
}
"""RPC00B names of the ten scalars, in the order files list them, and the model's fields."""

COEFFICIENT_FIELDS = {
    "LINE_NUM_COEFF": "line_num",
    "LINE_DEN_COEFF": "line_den",
    "SAMP_NUM_COEFF": "samp_num",
    "SAMP_DEN_COEFF": "samp_den",
}
"""RPC00B names of the four polynomials and the model's fields."""

_EXACT = Context(prec=400)
"""Enough digits that a double's decimal text plus or minus one is exact, down to 1e-380."""

PIXEL_ORIGIN = "0-based rows and columns, the centre of the first pixel is (0, 0)"
PIXEL_ORIGIN_DIMAP = "1-based rows and columns, the centre of the first pixel is (1, 1)"
HEIGHT_DATUM = "metres above the WGS 84 ellipsoid"
"""Said in every file for whoever opens it; no reader needs it."""

ERROR_FIELDS = {"ERR_BIAS": "err_bias_m", "ERR_RAND": "err_rand_m"}


@dataclass(frozen=True, slots=True)
class Entries:
    """Texts found in one file by the dialect's own keys; `place` turns a key into a place."""

    path: Path
    texts: Mapping[str, str]
    place: Callable[[str], str] = str

    def text(self, key: str) -> str:
        """Text under `key`; a missing one is a `ProductError`."""
        text = self.texts.get(key)
        if text is None:
            raise ProductError(self.path, self.place(key), "this key is missing")
        return text

    def number(self, key: str) -> float:
        """Finite number under `key`."""
        return number(self.path, self.place(key), self.text(key))

    def optional(self, key: str) -> float | None:
        """Finite number under `key`, or None where the key is absent."""
        return self.number(key) if key in self.texts else None


def number(path: Path, place: str, text: str) -> float:
    """Finite number in `text`; a unit may follow it."""
    words = text.split()
    try:
        value = float(words[0])
    except (ValueError, IndexError):
        raise ProductError(path, place, f"a number expected, got {text.strip()[:40]!r}") from None
    if not math.isfinite(value):
        raise ProductError(path, place, f"a finite number expected, got {words[0]}")
    return value


def twenty_numbers(path: Path, place: str, words: Sequence[str]) -> list[float]:
    """Twenty finite numbers."""
    if len(words) != 20:
        raise ProductError(path, place, f"20 coefficients expected, got {len(words)}")
    return [number(path, f"{place} ({i + 1})", word) for i, word in enumerate(words)]


def from_one_based(path: Path, place: str, text: str) -> float:
    """0-based value of a 1-based one; in decimal, so that writing it again gives `text`."""
    value = number(path, place, text)
    try:
        return float(_EXACT.subtract(Decimal(text.split()[0]), Decimal(1)))
    except InvalidOperation:
        return value - 1.0


def to_one_based(value: float) -> str:
    """1-based text of a 0-based value, which `from_one_based` reads back exactly."""
    return str(_EXACT.add(Decimal(repr(value)), Decimal(1)))


def build(path: Path, place: Callable[[str], str], fields: dict[str, Any]) -> RpcModel:
    """`RpcModel` of `fields`; what it refuses becomes a `ProductError`.

    `place` gives the file's own key for a field of the model.
    """
    for name in SCALAR_FIELDS.values():
        if name.partition("_")[2].startswith("scale") and fields[name] == 0.0:
            raise ProductError(path, place(name), "a scale other than zero expected")
    try:
        return RpcModel(**fields)
    except ArgumentError as error:
        raise ProductError(path, "", str(error)) from None
