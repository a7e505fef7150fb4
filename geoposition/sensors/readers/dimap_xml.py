"""What all DIMAP files share: units, dates, image size, corners, and blame for bad numbers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np

from geoposition.errors import (
    ArgumentError,
    ConvergenceError,
    GeometryError,
    ProductError,
    SpanError,
    UnsupportedError,
)
from geoposition.timescale import Epoch
from geoposition.xmlfile import XmlNode

MAX_SIZE_PX: Final = 10_000_000
HEIGHT_RANGE_M: Final = (-500.0, 9000.0)
"""Heights a model is meant for where the product states none: all of the Earth's land."""

_TIME_UNITS_S: Final = {
    "s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0,
    "ms": 1e-3, "millisecond": 1e-3, "milliseconds": 1e-3,
    "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "microsecond": 1e-6, "microseconds": 1e-6,
    "ns": 1e-9, "nanosecond": 1e-9, "nanoseconds": 1e-9,
}  # fmt: skip
_LENGTH_UNITS_M: Final = {
    "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "km": 1e3,
}  # fmt: skip
_SPEED_UNITS_M_S: Final = {"m/s": 1.0, "km/s": 1e3}
_UNITS: Final = {"s": _TIME_UNITS_S, "m": _LENGTH_UNITS_M, "m/s": _SPEED_UNITS_M_S}


@contextmanager
def blamed_on(node: XmlNode) -> Iterator[None]:
    """Turn what the nouns refuse inside the block into a `ProductError` that names `node`.

    Absurd numbers may overflow on their way to the refusal, without a warning.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            yield
    except (ArgumentError, GeometryError, SpanError, ConvergenceError) as error:
        raise ProductError(node.path, node.place, str(error)) from None


def unit_factor(node: XmlNode, si: str, default: str) -> float:
    """Factor to the SI unit `si` ("s", "m", "m/s") from the attribute `unit`, else `default`."""
    unit = (node.element.get("unit") or default).strip()
    factor = _UNITS[si].get(unit.lower())
    if factor is None:
        raise UnsupportedError(node.path, f"{node.place}@unit", f"{unit!r} is no known unit")
    return factor


def epoch_at(node: XmlNode, tag: str) -> Epoch:
    """UTC date in the descendant `tag`."""
    child = node.need(tag)
    with blamed_on(child):
        return Epoch.from_utc(child.text())


def line_period_s(node: XmlNode, default_unit: str) -> float:
    """Positive line period, seconds, in its own unit or `default_unit`."""
    period = node.number() * unit_factor(node, "s", default_unit)
    if not 1e-7 < period < 1.0:
        raise ProductError(node.path, node.place, f"a line period expected, got {period:g} s")
    return period


def image_shape(dimensions: XmlNode) -> tuple[int, int]:
    """NROWS and NCOLS of a Raster_Dimensions."""
    sizes = []
    for tag in ("NROWS", "NCOLS"):
        size = dimensions.integer(tag)
        if not 1 <= size <= MAX_SIZE_PX:
            raise ProductError(
                dimensions.path,
                f"{dimensions.place}/{tag}",
                f"an image size of 1 .. {MAX_SIZE_PX} expected, got {size}",
            )
        sizes.append(size)
    return sizes[0], sizes[1]


def corners(vertices: list[XmlNode], prefix: str = "") -> list[dict[str, float]]:
    """Read the maker's corners: `row`, `col` (0-based), `lon_deg`, `lat_deg`; heights unstated."""
    names = {"row": "ROW", "col": "COL", "lon_deg": "LON", "lat_deg": "LAT"}
    result = []
    for vertex in vertices:
        if any(vertex.find(prefix + tag) is None for tag in names.values()):
            continue
        corner = {name: vertex.number(prefix + tag) for name, tag in names.items()}
        result.append(corner | {"row": corner["row"] - 1.0, "col": corner["col"] - 1.0})
    return result
