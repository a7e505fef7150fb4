"""Community Sensor Model: line scanner states and support data, JSON.

A state is what usgscsm and ASP write: a first line with the model's name and a JSON object, or
the object alone. Support data (ISD) are what ALE writes. Both describe straight rays. The model
is for the Earth; `read_line_scanner` gives the rays of any body.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from geoposition.errors import (
    ArgumentError,
    GeometryError,
    ProductError,
    SpanError,
    UnsupportedError,
)
from geoposition.product import Product
from geoposition.sensors.readers.csm_isd import scanner_from_isd
from geoposition.sensors.readers.csm_json import LINE_SCANNER, read_json
from geoposition.sensors.readers.csm_scanner import LineScanner
from geoposition.sensors.readers.csm_state import scanner_from_state

if TYPE_CHECKING:
    from geoposition.sensors.readers.source import Source

FORMAT = "CSM line scanner (USGS)"
CANDIDATES = ("*.json", "**/*.json")

_MARKS = (b"USGS_ASTRO_", b'"m_modelName"', b'"m_intTimeStartTimes"', b'"line_scan_rate"')


def recognises(source: Source) -> bool:
    """Whether `source` is JSON of CSM: a model name, or keys that only CSM has."""
    head = source.head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not head.startswith((b"{", b"USGS_ASTRO_")):
        return False
    # A state's keys are sorted: the head may hold no more than the first ones.
    return any(mark in head for mark in (*_MARKS, b'"m_covariance"', b'"m_centerEphemerisTime"'))


def read_line_scanner(path: Path) -> LineScanner:
    """Camera, orbit and attitude of a state or support data, of any body."""
    name, node = read_json(path)
    is_state = node.has("m_intTimeStartTimes") or node.has("m_modelName")
    model = node.text("m_modelName" if is_state else "name_model", name)
    for stated, place in (
        (name, "first line"),
        (model, "m_modelName" if is_state else "name_model"),
    ):
        if stated and stated != LINE_SCANNER:
            raise UnsupportedError(path, place, f"{LINE_SCANNER} expected, got {stated[:60]}")
    try:
        return scanner_from_state(node) if is_state else scanner_from_isd(node)
    except SpanError as error:
        raise ProductError(path, "times", f"the image's lines are not covered: {error}") from error
    except ProductError:
        raise
    except ArgumentError as error:
        raise ProductError(path, "", str(error)) from error


def read(source: Source) -> Product:
    """Read a state or support data of the Earth; another body is an `UnsupportedError`."""
    scanner = read_line_scanner(source.path)
    try:
        model = scanner.model()
    except ProductError:
        raise
    except (ArgumentError, GeometryError, SpanError) as error:
        raise ProductError(source.path, "", str(error)) from error
    return Product(
        path=source.path,
        format=FORMAT,
        sensor=scanner.sensor,
        model=model,
        start=scanner.start,
        details={
            "time": "ephemeris time, TDB taken as TT"
            if scanner.start is not None
            else "the state gives times from an unstated epoch",
        },
    )
