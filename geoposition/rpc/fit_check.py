"""What an RPC misses of the model it was fitted to, at points the fit has not seen."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from geoposition.arrays import FlagArray, FloatArray, read_only
from geoposition.errors import GeometryError
from geoposition.flags import has_result
from geoposition.rpc.fit_basis import monomials
from geoposition.rpc.fit_grid import image_grid
from geoposition.rpc.model import RpcModel
from geoposition.sensor_model import SensorModel

_MOST_LINES = 20_000
_CUBE = 21


@dataclass(frozen=True, slots=True)
class Misfit:
    """Misfit along one axis, px: `mean`, root mean square `rms`, `max` of the absolute values."""

    mean: float
    rms: float
    max: float

    @classmethod
    def of(cls, values: FloatArray) -> Misfit:
        """Statistics of finite `values`."""
        rms = math.sqrt(float(np.mean(values * values)))
        return cls(float(values.mean()), rms, float(np.abs(values).max()))

    def as_dict(self) -> dict[str, float]:
        """Return the numbers by name."""
        return {"mean": self.mean, "rms": self.rms, "max": self.max}


@dataclass(frozen=True, slots=True, eq=False)
class FitCheck:
    """RPC − model, px, on a grid between the nodes of the fit and at other heights.

    `difference_px` (k, n, m, 2) as (line, sample) has the axes `height_m`, `line_px`,
    `samp_px`; it is NaN where `flag` has no result. `profile_line_px` (p) and `profile_px`
    (p, 2) are the mean over the samples of single lines at middle height, densely along the
    image: what changes from line to line is motion that an RPC cannot follow. `den_range`
    (2, 2) are the extremes of both denominators, over their mean, on the ground of the grid;
    `cube_range` (2, 2) over all of the normalised cube ±1. `direct` is how far the direct
    coefficients, followed by the inverse ones, lead away from where they began.
    """

    points: int
    missed: int
    row: Misfit
    col: Misfit
    line_px: FloatArray
    samp_px: FloatArray
    height_m: FloatArray
    difference_px: FloatArray
    flag: FlagArray
    profile_line_px: FloatArray
    profile_px: FloatArray
    den_range: FloatArray
    cube_range: FloatArray
    direct: tuple[Misfit, Misfit] | None

    @property
    def largest_px(self) -> float:
        """Largest misfit along either axis."""
        return max(self.row.max, self.col.max)

    def as_dict(self) -> dict[str, object]:
        """Return the summary by name."""
        motion = self.profile_px - self.profile_px.mean(axis=0)
        result: dict[str, object] = {
            "points": self.points,
            "missed": self.missed,
            "row": self.row.as_dict(),
            "col": self.col.as_dict(),
            "line_profile_rms_px": np.sqrt(np.mean(motion**2, axis=0)).tolist(),
            "denominators": self.den_range.tolist(),
            "denominators_in_cube": self.cube_range.tolist(),
        }
        if self.direct is not None:
            result["direct"] = {
                "row": self.direct[0].as_dict(),
                "col": self.direct[1].as_dict(),
            }
        return result


def check_fit(
    model: SensorModel,
    rpc: RpcModel,
    line_px: FloatArray,
    samp_px: FloatArray,
    height_m: FloatArray,
) -> FitCheck:
    """Compare `rpc` with `model` between the nodes `line_px`, `samp_px`, `height_m` of a fit.

    The grid has the middles of the nodes and, of lines and samples, the image's edges.
    """
    line, samp, height = _between(line_px), _between(samp_px), _middles(height_m)
    image, heights = image_grid(line, samp, height)
    ground = model.image_to_ground(image, heights)
    found = rpc.ground_to_image(ground.geodetic)
    flag = np.where(has_result(ground.flag), found.flag, ground.flag)
    good = has_result(flag)
    if not good.any():
        raise GeometryError("RPC fit: no point of the check grid is answered by model and RPC")
    difference = np.where(good[..., None], found.image_px - image, np.nan)
    profile_line, profile = _profile(model, rpc, line_px, samp_px, height_m)
    direct = None
    if rpc.direct is not None:
        back = rpc.ground_to_image(rpc.direct_image_to_ground(image[good], heights[good]))
        loop = (back.image_px - image[good])[has_result(back.flag)]
        direct = Misfit.of(loop[:, 0]), Misfit.of(loop[:, 1])
    flag.setflags(write=False)
    return FitCheck(
        points=int(good.sum()),
        missed=int(good.size - good.sum()),
        row=Misfit.of(difference[good][:, 0]),
        col=Misfit.of(difference[good][:, 1]),
        line_px=read_only(line),
        samp_px=read_only(samp),
        height_m=read_only(height),
        difference_px=read_only(difference),
        flag=flag,
        profile_line_px=read_only(profile_line),
        profile_px=read_only(profile),
        den_range=denominators(rpc, ground.geodetic[good]),
        cube_range=cube_range(np.stack([rpc.line_den, rpc.samp_den])),
        direct=direct,
    )


def _profile(
    model: SensorModel, rpc: RpcModel, line_px: FloatArray, samp_px: FloatArray, height: FloatArray
) -> tuple[FloatArray, FloatArray]:
    first, last = math.ceil(line_px[0]), math.floor(line_px[-1])
    step = max(1, -(-(last - first + 1) // _MOST_LINES))
    line = np.arange(first, last + 1, step, dtype=np.float64)
    samp = samp_px[[len(samp_px) // 6, len(samp_px) // 2, -1 - len(samp_px) // 6]]
    image, heights = image_grid(line, samp, np.array([0.5 * (height[0] + height[-1])]))
    ground = model.image_to_ground(image, heights)
    difference = (rpc.ground_to_image(ground.geodetic).image_px - image)[0]
    good = np.isfinite(difference).all(axis=(1, 2))
    return line[good], difference[good].mean(axis=1)


def cube_range(den: FloatArray) -> FloatArray:
    """Extremes (2, 2) of two denominators (2, 20), over their mean, in the cube ±1."""
    return _extremes(den @ _cube())


@cache
def _cube() -> FloatArray:
    even = np.linspace(-1.0, 1.0, _CUBE)
    cube = np.stack(np.meshgrid(even, even, even, indexing="ij"))
    return read_only(monomials(cube.reshape(3, -1)))


def _extremes(values: FloatArray) -> FloatArray:
    """Extremes (2, 2) of values (2, n) over their mean."""
    values = values / values.mean(axis=1, keepdims=True)
    return read_only(np.stack([values.min(axis=1), values.max(axis=1)], axis=1))


def denominators(rpc: RpcModel, geodetic: FloatArray) -> FloatArray:
    """Extremes (2, 2) of both denominators, over their mean, at `geodetic` (n, 3)."""
    off = np.array([rpc.lon_off_deg, rpc.lat_off_deg, rpc.height_off_m])
    scale = np.array([rpc.lon_scale_deg, rpc.lat_scale_deg, rpc.height_scale_m])
    ground = geodetic * (math.degrees(1.0), math.degrees(1.0), 1.0) - off
    ground[:, 0] -= 360.0 * np.rint(ground[:, 0] / 360.0)
    return _extremes(np.stack([rpc.line_den, rpc.samp_den]) @ monomials((ground / scale).T))


def _middles(nodes: FloatArray) -> FloatArray:
    if len(nodes) < 2:
        return nodes
    middles: FloatArray = 0.5 * (nodes[1:] + nodes[:-1])
    return middles


def _between(nodes: FloatArray) -> FloatArray:
    return np.concatenate([nodes[:1], _middles(nodes), nodes[-1:]])
