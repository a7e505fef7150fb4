"""What an RPC is fitted to: image points with their ground, and the numbers that normalise them."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray, read_only
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import flag_labels, has_result
from geoposition.sensor_model import SensorModel

LEAST_HALF_HEIGHT_M: Final = 50.0
"""A height range is widened to this much about its middle: an RPC needs one to be one."""

_LONGITUDE_SPREAD_RAD: Final = math.radians(170.0)
_MOST_MISSED: Final = 0.02


@dataclass(frozen=True, slots=True)
class Samples:
    """Image points `image_px` (n, 2) and their ground `geodetic` (n, 3), longitudes unbroken.

    Longitudes follow each other without a jump at ±180°, so they may lie beyond.
    """

    image_px: FloatArray
    geodetic: FloatArray

    @classmethod
    def of(cls, image_px: FloatArray, geodetic: FloatArray) -> Samples:
        """Samples of (..., 2) and (..., 3); what is not finite is an `ArgumentError`."""
        image, ground = image_px.reshape(-1, 2), geodetic.reshape(-1, 3).copy()
        if len(image) != len(ground):
            raise ArgumentError(f"samples: {len(image)} image points, {len(ground)} ground points")
        if not (np.all(np.isfinite(image)) and np.all(np.isfinite(ground))):
            raise ArgumentError("samples: finite image and ground points expected")
        if np.any(np.abs(ground[:, 1]) > 0.5 * math.pi):
            raise ArgumentError("samples: latitudes within ±90° expected")
        ground[:, 0] = unbroken(ground[:, 0])
        if np.ptp(ground[:, 0]) > _LONGITUDE_SPREAD_RAD:
            latitude = math.degrees(float(np.abs(ground[:, 1]).max()))
            raise GeometryError(
                f"RPC fit: the ground spans {math.degrees(np.ptp(ground[:, 0])):.0f} degrees of "
                f"longitude, up to latitude {latitude:.3f}: an RPC in longitude and latitude "
                "cannot describe an image around a pole"
            )
        return cls(read_only(image), read_only(ground))


@dataclass(frozen=True, slots=True)
class Normalisation:
    """Offsets and scales of (line, sample) and of (longitude, latitude, height) in deg and m."""

    image_off_px: FloatArray
    image_scale_px: FloatArray
    ground_off: FloatArray
    ground_scale: FloatArray

    @classmethod
    def of(cls, samples: Samples, shape: tuple[int, int] | None) -> Normalisation:
        """Round numbers whose offset and scale reach the first and last pixel, and all ground.

        Whole pixels and metres and 0.0001°, which the fixed-width fields of RPC00B hold.
        """
        if shape is None:
            low, high = samples.image_px.min(axis=0), samples.image_px.max(axis=0)
        else:
            low, high = np.zeros(2), np.array(shape, dtype=np.float64) - 1.0
        image_off = np.floor(0.5 * (low + high))
        image_scale = np.maximum(np.ceil(np.maximum(high - image_off, image_off - low)), 1.0)
        ground = samples.geodetic * (math.degrees(1.0), math.degrees(1.0), 1.0)
        low, high = ground.min(axis=0), ground.max(axis=0)
        steps = np.array([1e4, 1e4, 1.0])
        off = np.round(0.5 * (low + high) * steps) / steps
        reach = np.maximum(high - off, off - low)
        scale = np.maximum(np.ceil(reach * steps), 1.0) / steps
        return cls(image_off, image_scale, off, scale)

    @property
    def lon_off_deg(self) -> float:
        """Longitude offset brought into ±180°."""
        return float(math.remainder(self.ground_off[0], 360.0))

    @property
    def metres(self) -> FloatArray:
        """What 1 of normalised longitude and latitude is worth on the ground, about."""
        per_deg = 111_200.0
        east = per_deg * math.cos(math.radians(self.ground_off[1]))
        return self.ground_scale[:2] * (max(east, 1.0), per_deg)

    def image(self, image_px: FloatArray) -> FloatArray:
        """Normalised (line, sample) as (2, n)."""
        return ((image_px - self.image_off_px) / self.image_scale_px).T

    def ground(self, geodetic: FloatArray) -> FloatArray:
        """Normalised (longitude, latitude, height) as (3, n)."""
        units = (math.degrees(1.0), math.degrees(1.0), 1.0)
        return ((geodetic * units - self.ground_off) / self.ground_scale).T


def virtual_grid(
    model: SensorModel, heights_m: tuple[float, float], nodes: tuple[int, int, int]
) -> Samples:
    """Ground of `nodes` (lines, samples, heights), from edge to edge of the image of `model`.

    Points that the model does not answer are left out; if that is more than 2 %, a
    `GeometryError` says why.
    """
    line, sample, height = axes(model.shape, heights_m, nodes)
    return sample_model(model, line, sample, height)


def axes(
    shape: tuple[int, int], heights_m: tuple[float, float], nodes: tuple[int, int, int]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Even nodes of lines, samples (edge to edge) and heights."""
    return (
        np.linspace(-0.5, shape[0] - 0.5, nodes[0]),
        np.linspace(-0.5, shape[1] - 0.5, nodes[1]),
        np.linspace(*heights_m, nodes[2]),
    )


def image_grid(
    line_px: FloatArray, sample_px: FloatArray, height_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Image points (k, n, m, 2) and heights (k, n, m) of a grid's axes."""
    image = np.stack(np.meshgrid(line_px, sample_px, indexing="ij"), axis=-1)
    shape = (len(height_m), *image.shape[:-1])
    return (
        np.broadcast_to(image, (*shape, 2)),
        np.broadcast_to(height_m[:, None, None], shape),
    )


def sample_model(
    model: SensorModel, line_px: FloatArray, sample_px: FloatArray, height_m: FloatArray
) -> Samples:
    """Samples of `model` at the nodes of a grid."""
    image, heights = image_grid(line_px, sample_px, height_m)
    ground = model.image_to_ground(image, heights)
    good = has_result(ground.flag)
    missed = good.size - int(good.sum())
    if missed > _MOST_MISSED * good.size:
        reasons = Counter(flag_labels(ground.flag[~good]).tolist())
        words = ", ".join(f"{count} {name}" for name, count in reasons.most_common())
        raise GeometryError(
            f"RPC fit: the model does not answer at {missed} of {good.size} nodes of the grid "
            f"({words})"
        )
    return Samples.of(image[good], ground.geodetic[good])


def widened(heights_m: tuple[float, float]) -> tuple[float, float]:
    """Return the height range, at least `LEAST_HALF_HEIGHT_M` to each side of its middle."""
    low, high = float(heights_m[0]), float(heights_m[1])
    if not (math.isfinite(low) and math.isfinite(high) and -12e3 < low <= high < 100e3):
        raise ArgumentError(f"heights: metres, low to high, expected; got {low} .. {high}")
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), LEAST_HALF_HEIGHT_M)
    return middle - half, middle + half


def unbroken(lon_rad: FloatArray) -> FloatArray:
    """Longitudes within half a turn of their mean direction, which is within ±180°."""
    middle = math.atan2(float(np.sin(lon_rad).mean()), float(np.cos(lon_rad).mean()))
    turns = np.rint((lon_rad - middle) / (2.0 * math.pi))
    return lon_rad - 2.0 * math.pi * turns
