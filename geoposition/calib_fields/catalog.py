"""The calibration fields of P's scenes; the rasters are the user's own.

The extents are those of the places of that name, generous: enough to tell which field an image
sees, not a survey's boundary. What is published here is what P found there; the accuracy of the
fields' orthophotos and DEMs is with their owners, and belongs in the user's `field.toml`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from geoposition.calib_fields.field import Extent, Field
from geoposition.errors import ArgumentError

_REMARK: Final = "calibration field of P; orthophoto and DEM are to be supplied by the user"

CATALOG: Final[dict[str, Field]] = {
    "songshan": Field("Songshan", Extent(112.4, 34.1, 114.2, 35.0), remarks=f"Henan; {_REMARK}"),
    "yili": Field("Yili", Extent(80.5, 43.0, 82.5, 44.5), remarks=f"Xinjiang; {_REMARK}"),
    "anyang": Field("Anyang", Extent(113.6, 35.5, 115.0, 36.5), remarks=f"Henan; {_REMARK}"),
    "dongying": Field("Dongying", Extent(118.0, 36.9, 119.4, 38.2), remarks=f"Shandong; {_REMARK}"),
}


@dataclass(frozen=True, slots=True)
class PublishedScene:
    """A scene of P: relative accuracy, pixels, with on-board attitude and compensated.

    `mean_px` and `rms_px` are (x, y) of the compensated scene; P's heading of table 2 has My and
    Mx swapped, the order here is that of table 1. *Source*: P tables 1 and 2.
    """

    date: str
    side_swing_deg: float
    region: str
    onboard_px: float
    compensated_px: float
    onboard_mean_px: tuple[float, float]
    onboard_rms_px: tuple[float, float]
    mean_px: tuple[float, float]
    rms_px: tuple[float, float]


PUBLISHED: Final = (
    PublishedScene(
        "2015-08-29 14:08", -4.965, "Songshan", 3.729, 1.454,
        (0.037, 0.008), (3.114, 2.052), (-0.024, -0.014), (1.026, 1.031),
    ),
    PublishedScene(
        "2015-08-31 16:26", 4.727, "Yili", 3.069, 1.562,
        (-0.011, -0.009), (2.401, 1.912), (0.013, 0.007), (1.211, 0.987),
    ),
    PublishedScene(
        "2015-09-03 13:42", -8.428, "Anyang", 3.412, 1.323,
        (-0.015, 0.031), (2.588, 2.224), (-0.011, 0.021), (0.854, 1.011),
    ),
    PublishedScene(
        "2015-09-16 16:19", -6.299, "Yili", 4.314, 1.425,
        (0.018, 0.019), (3.841, 1.965), (0.009, -0.023), (1.246, 0.693),
    ),
    PublishedScene(
        "2015-09-26 13:52", -7.711, "Dongying", 3.817, 1.459,
        (-0.006, 0.009), (3.187, 2.101), (0.005, 0.007), (1.104, 0.955),
    ),
)  # fmt: skip


def catalogued(name: str) -> Field:
    """Return the entry called `name`, in any case; another name is an `ArgumentError`."""
    found = CATALOG.get(name.strip().lower())
    if found is None:
        raise ArgumentError(f"no field {name!r}: one of {', '.join(CATALOG)} expected")
    return found


def fields_at(lon_deg: float, lat_deg: float) -> tuple[Field, ...]:
    """Catalogued fields whose extent holds a place."""
    return tuple(
        field
        for field in CATALOG.values()
        if field.extent is not None and field.extent.contains(lon_deg, lat_deg)
    )
