"""Matches of the first image's pixels in one or more others, to ground points.

Two lines of sight meet at their midpoint, three and more at their least-squares point. The
standard deviation of a height is that of the disparity, by how many pixels a metre moves it:
what the covariance of an intersection is, along the one direction in which a dense match has an
error that matters. Several images combine as independent measurements do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geoposition.arrays import BoolArray, FloatArray
from geoposition.dense.filters import Grey
from geoposition.dense.pair_tile import CoreMatches
from geoposition.flags import Flag, has_result
from geoposition.intersect import intersect_rays
from geoposition.rays import Rays
from geoposition.sensor_model import SensorModel


@dataclass(frozen=True, slots=True, eq=False)
class DensePoints:
    """Ground points of n pixels of the first image.

    `first_px` (n, 2); `geodetic` (n, 3); `sigma_m` (n,) of the height, from matching alone;
    `rays` (n,) how many images see it; `grey` (n,) what the first image shows there.
    """

    first_px: FloatArray
    geodetic: FloatArray
    sigma_m: Grey
    rays: np.ndarray[tuple[int], np.dtype[np.uint8]]
    grey: Grey

    def __len__(self) -> int:
        return len(self.geodetic)


def ground_points(
    models: Sequence[SensorModel],
    first_px: FloatArray,
    grey: Grey,
    matches: Sequence[CoreMatches | None],
    most_miss_m: float,
) -> DensePoints:
    """Merge what the other images say of the pixels `first_px` (n, 2), row by row of a core.

    `matches` are those of `models[1:]`. A pixel that one image shows has the pair's point; one
    that several show is intersected anew, and left out if a line of sight passes the point by
    more than `most_miss_m`.
    """
    found = [(k, match) for k, match in enumerate(matches) if match is not None]
    geodetic = found[0][1].geodetic.reshape(-1, 3)
    sigma_m = found[0][1].sigma_m.reshape(-1)
    count = np.ones(len(first_px), dtype=np.uint8)
    if len(found) > 1:
        known = np.stack([np.isfinite(match.geodetic[..., 2]).reshape(-1) for _, match in found])
        count = known.sum(axis=0, dtype=np.uint8)
        geodetic = geodetic.copy()
        weight = np.zeros(len(first_px), dtype=np.float32)
        for mine, (_, match) in zip(known, found, strict=True):
            np.copyto(
                geodetic, match.geodetic.reshape(-1, 3), where=(mine & ~_finite(geodetic))[:, None]
            )
            weight[mine] += 1.0 / np.square(match.sigma_m.reshape(-1)[mine])
        with np.errstate(divide="ignore"):
            sigma_m = np.sqrt(1.0 / weight)
        several = np.flatnonzero(count > 1)
        if len(several):
            places = [(models[0], first_px[several], np.ones(len(several), dtype=np.bool_))]
            places += [
                (models[k + 1], match.second_px.reshape(-1, 2)[several], mine[several])
                for mine, (k, match) in zip(known, found, strict=True)
            ]
            geodetic[several] = _many(places, geodetic[several, 2], most_miss_m)
    good = np.flatnonzero(_finite(geodetic))
    return DensePoints(
        first_px[good],
        geodetic[good],
        sigma_m[good],
        count[good] + np.uint8(1),
        grey[good],
    )


def _finite(geodetic: FloatArray) -> BoolArray:
    return np.isfinite(geodetic[:, 2])


def _many(
    places: Sequence[tuple[SensorModel, FloatArray, BoolArray]],
    height_m: FloatArray,
    most_miss_m: float,
) -> FloatArray:
    """Least-squares points (n, 3) of models, their image points and which count; NaN at odds."""
    size = (len(height_m), len(places))
    origin, direction = np.zeros((*size, 3)), np.zeros((*size, 3))
    flag = np.full(size, Flag.BAD_INPUT, dtype=np.uint8)
    used = np.stack([counts for _, _, counts in places], axis=1)
    for k, (model, image_px, counts) in enumerate(places):
        rays = model.rays(image_px[counts], height_m[counts])
        origin[counts, k], direction[counts, k] = rays.origin_ecef_m, rays.direction_ecef
        flag[counts, k] = rays.flag
    start = np.concatenate([[0], np.cumsum(used.sum(axis=1))])
    found = intersect_rays(Rays(origin[used], direction[used], flag[used]), start)
    worst = np.maximum.reduceat(np.nan_to_num(found.residual_m, nan=np.inf), start[:-1])
    good = has_result(found.flag) & (worst <= most_miss_m)
    return np.where(good[:, None], found.geodetic, np.nan)
