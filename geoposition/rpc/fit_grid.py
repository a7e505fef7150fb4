"""What an RPC is fitted to: image points with their ground, and the numbers that normalise them."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import flag_labels, has_result
from geoposition.longitudes import unbroken
from geoposition.sensor_model import SensorModel

LEAST_HALF_HEIGHT_M: Final = 50.0
"""A height range is widened to this much about its middle: an RPC needs one to be one."""

_LONGITUDE_SPREAD_RAD: Final = math.radians(170.0)
_MOST_MISSED: Final = 0.02


@dataclass(frozen=True, slots=True)
class Samples:
    """Image points and their ground in columns: `image_px` (2, n), `geodetic` (3, n).

    Longitudes follow each other without a jump at ±180°, so they may lie beyond. `image_range`
    (2, 2) and `ground_range` (3, 2) are lowest and highest of each.
    """

    image_px: FloatArray
    geodetic: FloatArray
    image_range: FloatArray
    ground_range: FloatArray

    @classmethod
    def of(cls, image_px: FloatArray, geodetic: FloatArray) -> Samples:
        """Take points (..., 2) and (..., 3); what is not finite is an `ArgumentError`."""
        image = np.array(image_px.reshape(-1, 2).T, order="C")
        ground = np.array(geodetic.reshape(-1, 3).T, order="C")
        if image.shape[1] != ground.shape[1] or not image.size:
            raise ArgumentError(
                f"samples: as many image as ground points expected, "
                f"got {image.shape[1]} and {ground.shape[1]}"
            )
        image_range = np.stack([image.min(axis=1), image.max(axis=1)], axis=1)
        if not (np.all(np.isfinite(image_range)) and np.all(np.isfinite(ground.sum(axis=1)))):
            raise ArgumentError("samples: finite image and ground points expected")
        ground[0] = unbroken(ground[0])
        ground_range = np.stack([ground.min(axis=1), ground.max(axis=1)], axis=1)
        if np.abs(ground_range[1]).max() > 0.5 * math.pi:
            raise ArgumentError("samples: latitudes within ±90° expected")
        spread = ground_range[0, 1] - ground_range[0, 0]
        if spread > _LONGITUDE_SPREAD_RAD:
            latitude = math.degrees(float(np.abs(ground_range[1]).max()))
            raise GeometryError(
                f"RPC fit: the ground spans {math.degrees(spread):.0f} degrees of longitude, up "
                f"to latitude {latitude:.3f}: an RPC in longitude and latitude cannot describe "
                "an image around a pole"
            )
        for array in (image, ground, image_range, ground_range):
            array.setflags(write=False)
        return cls(image, ground, image_range, ground_range)


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
            low, high = samples.image_range.T
        else:
            low, high = np.zeros(2), np.array(shape, dtype=np.float64) - 1.0
        image_off = np.floor(0.5 * (low + high))
        image_scale = np.maximum(np.ceil(np.maximum(high - image_off, image_off - low)), 1.0)
        low, high = samples.ground_range.T * (math.degrees(1.0), math.degrees(1.0), 1.0)
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

    def image(self, samples: Samples) -> FloatArray:
        """Normalised (line, sample) of samples, (2, n)."""
        off, scale = self.image_off_px[:, None], self.image_scale_px[:, None]
        result: FloatArray = (samples.image_px - off) / scale
        return result

    def ground(self, samples: Samples) -> FloatArray:
        """Normalised (longitude, latitude, height) of samples, (3, n)."""
        unit = (
            np.array([[math.degrees(1.0)], [math.degrees(1.0)], [1.0]]) / self.ground_scale[:, None]
        )
        result: FloatArray = samples.geodetic * unit
        result -= (self.ground_off / self.ground_scale)[:, None]
        return result


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
    """Take samples of `model` at the nodes of a grid."""
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
