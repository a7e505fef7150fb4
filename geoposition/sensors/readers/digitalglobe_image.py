"""Group IMD of DigitalGlobe support data: the image, its level and its line times.

Source: DigitalGlobe, Imagery Support Data (ISD) Documentation 1.1.2 (2014).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from geoposition.camera import LineTiming
from geoposition.errors import UnsupportedError
from geoposition.sensors.readers.digitalglobe_tree import Group
from geoposition.sensors.timing import ConstantLineRate, LineTimeTable
from geoposition.timescale import Epoch

SATELLITES = {
    "QB02": "QuickBird-2",
    "GE01": "GeoEye-1",
    "WV01": "WorldView-1",
    "WV02": "WorldView-2",
    "WV03": "WorldView-3",
    "WV04": "WorldView-4",
}
UNVERIFIED = {"QB02", "WV04"}
"""Satellites for which no data were at hand to check the conventions."""
_RAW = re.compile(r"[A-Z]*1B")
"""Levels in the camera's own geometry: `LV1B`, `Stereo 1B`."""
_RESAMPLED = re.compile(r"[A-Z]*(2A|3[A-Z]?|4[A-Z]?)")
"""Levels on a map grid: `LV2A`, `Stereo OR2A`, `LV3D`."""
_CORNERS = ("UL", "UR", "LR", "LL")


@dataclass(frozen=True, slots=True)
class ImageSupport:
    """Group IMD: the image. `corners` are (lon_deg, lat_deg, height_m), as the maker states them.

    `timing` is None where the product holds no line times (ortho-ready levels).
    """

    group: Group
    satellite: str
    level: str
    descriptor: str
    band: str
    shape: tuple[int, int]
    corners: dict[str, tuple[float, float, float]]
    facts: dict[str, object]
    timing: LineTiming | None
    start: Epoch | None
    notes: tuple[str, ...]

    @property
    def is_raw_geometry(self) -> bool:
        """Whether the pixels are those of the camera: Basic 1B, one by one or in stereo."""
        return _is_raw(self.level)


def _is_raw(level: str) -> bool:
    return _RAW.fullmatch(level.replace(" ", "").upper()) is not None


def _is_resampled(level: str) -> bool:
    return _RESAMPLED.fullmatch(level.replace(" ", "").upper()) is not None


def parse_image(imd: Group) -> ImageSupport:
    """Read IMD."""
    level = imd.text("productLevel")
    raw = _is_raw(level)
    if not raw and not _is_resampled(level):
        raise UnsupportedError(
            imd.path, imd.place_of("productLevel"), f"level 1B, 2A or 3 expected, got {level!r}"
        )
    images = imd.named("IMAGE")
    if len(images) > 1 and raw:
        raise UnsupportedError(imd.path, images[1].place, "one image expected in a 1B product")
    image = imd.need("IMAGE")
    satellite = image.text("satId").upper()
    if satellite not in SATELLITES:
        raise UnsupportedError(
            image.path, image.place_of("satId"), f"{satellite!r} is none of {', '.join(SATELLITES)}"
        )
    lines, samples = imd.integer("numRows"), imd.integer("numColumns")
    for name, size in (("numRows", lines), ("numColumns", samples)):
        if not 1 <= size <= 10_000_000:
            raise imd.error(name, f"an image size expected, got {size}")
    notes: list[str] = []
    timing = _timing(image, notes) if raw else None
    facts: dict[str, object] = {}
    for label, group, name in (
        ("catalogue_id", image, "catId"),
        ("generated", imd, "generationTime"),
        ("scan_direction", image, "scanDirection"),
        ("mode", image, "mode"),
    ):
        if group.has(name):
            facts[label] = group.text(name)
    for label, name in (
        ("line_rate_hz", "avgLineRate"),
        ("ground_sample_distance_m", "meanProductGSD"),
        ("off_nadir_angle_deg", "meanOffNadirViewAngle"),
        ("in_track_angle_deg", "meanInTrackViewAngle"),
        ("cross_track_angle_deg", "meanCrossTrackViewAngle"),
        ("satellite_azimuth_deg", "meanSatAz"),
        ("satellite_elevation_deg", "meanSatEl"),
    ):
        if image.has(name):
            facts[label] = image.number(name)
    return ImageSupport(
        imd,
        satellite,
        level,
        imd.text("imageDescriptor") if imd.has("imageDescriptor") else "",
        imd.text("bandId"),
        (lines, samples),
        _corners(imd),
        facts,
        timing,
        image.epoch("firstLineTime") if image.has("firstLineTime") or raw else None,
        tuple(notes),
    )


def _corners(imd: Group) -> dict[str, tuple[float, float, float]]:
    bands = [group for name, group in imd.groups if name.startswith("BAND_")]
    if not bands or not bands[0].has("ULLon"):
        return {}
    band = bands[0]
    return {
        corner: (
            band.number(f"{corner}Lon"),
            band.number(f"{corner}Lat"),
            band.number(f"{corner}HAE") if band.has(f"{corner}HAE") else float("nan"),
        )
        for corner in _CORNERS
    }


def _timing(image: Group, notes: list[str]) -> LineTiming:
    """Line times: TLCTIME plus TLCLIST, linear between its pairs (line, seconds).

    Times fall in reverse scans. Of a single pair, the rate is AVGLINERATE and the scan
    direction gives its sign.
    """
    epoch = image.epoch("TLCTime")
    table = image.table("TLCList", 2)
    count = image.integer("numTLC")
    if count != len(table):
        raise image.error("TLCList", f"{count} pair(s) expected by numTLC, got {len(table)}")
    direction = image.text("scanDirection")
    if direction.lower() not in ("forward", "reverse"):
        raise image.error("scanDirection", f"Forward or Reverse expected, got {direction!r}")
    sign = 1.0 if direction.lower() == "forward" else -1.0
    timing: LineTiming
    if len(table) == 0:
        raise image.error("TLCList", "one or more pairs of line and time expected")
    if len(table) == 1:
        rate = image.number("avgLineRate")
        if rate <= 0:
            raise image.error("avgLineRate", f"a positive rate expected, got {rate}")
        line, seconds = table[0]
        timing = ConstantLineRate(epoch, float(seconds - sign * line / rate), sign / rate)
        notes.append("line times: one TLC pair, continued with AVGLINERATE")
    else:
        with image.blaming("TLCList"):
            timing = LineTimeTable(epoch, table[:, 0], table[:, 1])
        period = float((table[-1, 1] - table[0, 1]) / (table[-1, 0] - table[0, 0]))
        if not 1e-7 < abs(period) < 0.1:
            raise image.error("TLCList", f"a line time in seconds expected, {period:g} s per line")
        if period * sign < 0:
            notes.append(f"line times: TLCLIST contradicts the scan direction {direction}; used")
    first = image.epoch("firstLineTime")
    offset = (epoch - first) + float(timing.time_s(0.0))
    if abs(offset) > 1e-4:
        notes.append(f"line times: TLCLIST puts line 0 {offset:+.6f} s off FIRSTLINETIME; used")
    return timing
