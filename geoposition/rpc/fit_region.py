"""Where an RPC was fitted, and therefore may be trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import BoolArray
from geoposition.rpc.fit_grid import Samples
from geoposition.rpc.model import RpcValidity


@dataclass(frozen=True, slots=True)
class FittedRegion:
    """First and last line, sample, longitude, latitude and height of the points fitted to.

    Longitudes do not jump at ±180°: the last may be beyond.
    """

    line_px: tuple[float, float]
    samp_px: tuple[float, float]
    lon_deg: tuple[float, float]
    lat_deg: tuple[float, float]
    height_m: tuple[float, float]

    @classmethod
    def of(cls, samples: Samples) -> FittedRegion:
        """Region of `samples`."""
        ground = samples.ground_range * [[math.degrees(1.0)], [math.degrees(1.0)], [1.0]]
        return cls(*((float(low), float(high)) for low, high in (*samples.image_range, *ground)))

    @property
    def validity(self) -> RpcValidity:
        """The part of it that RPC files can state."""
        return RpcValidity(self.line_px, self.samp_px, self.lon_deg, self.lat_deg)

    def outside(self, image_px: ArrayLike, height_m: ArrayLike) -> BoolArray:
        """Tell which image points (..., 2) at heights (...) are outside: nothing holds there."""
        image = np.asarray(image_px, dtype=np.float64)
        height = np.asarray(height_m, dtype=np.float64)
        slack = 1e-6
        inside = np.ones(np.broadcast_shapes(image.shape[:-1], height.shape), dtype=np.bool_)
        ranges = (self.line_px, self.samp_px, self.height_m)
        for value, (low, high) in zip((image[..., 0], image[..., 1], height), ranges, strict=True):
            inside &= (value >= low - slack) & (value <= high + slack)
        return ~inside

    def statement(self) -> str:
        """Say it in one line."""
        (l0, l1), (s0, s1), (h0, h1) = self.line_px, self.samp_px, self.height_m
        lon = [math.remainder(value, 360.0) for value in self.lon_deg]
        lat = self.lat_deg
        return (
            f"rows {l0:g} .. {l1:g}, cols {s0:g} .. {s1:g}, heights {h0:g} .. {h1:g} m, "
            f"lon {lon[0]:.5f} .. {lon[1]:.5f}, lat {lat[0]:.5f} .. {lat[1]:.5f}"
        )
