"""The RPC model: ratios of cubics from ground to image, used in both directions.

The inverse coefficients (ground to image) are the model. `image_to_ground` inverts them by
Newton's method, so that both directions agree to rounding; direct coefficients, where a product
carries them, were fitted separately and agree with the inverse ones to the maker's fit error
only. They are kept for information and comparison (`direct_image_to_ground`).

Normalised coordinates are never clipped. Heights are above the WGS 84 ellipsoid; the image is
0-based, the first pixel's centre at (0, 0): readers and writers convert.

*Source*: STDI-0002 vol. 1 appendix E (RPC00B), section E.2.4.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FlagArray, FloatArray, as_components
from geoposition.errors import ArgumentError
from geoposition.rays import Rays
from geoposition.rpc.direct import DirectRpc, twenty
from geoposition.rpc.kernel_base import KernelParameters
from geoposition.rpc.kernels import project_points
from geoposition.rpc.kernels_inverse import locate_points
from geoposition.rpc.kernels_sight import differentiate_points, sight_lines
from geoposition.rpc.start import HEIGHT_MARGIN_M, StartTable, find_start
from geoposition.sensor_model import GroundPoints, ImagePoints

RAY_ALTITUDE_M = 100e3
"""How high above its ground point a ray of an RPC begins."""

_SCALES = ("line_scale_px", "samp_scale_px", "lon_scale_deg", "lat_scale_deg", "height_scale_m")
_OFFS = ("line_off_px", "samp_off_px", "lon_off_deg", "lat_off_deg", "height_off_m")


@dataclass(frozen=True, slots=True)
class RpcValidity:
    """Where the maker fitted the coefficients: first and last, as the product states it.

    Lines and samples are 0-based, longitudes and latitudes in degrees.
    """

    line_px: tuple[float, float]
    samp_px: tuple[float, float]
    lon_deg: tuple[float, float]
    lat_deg: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class RpcModel:
    """Image geometry as ratios of cubics; a `SensorModel`.

    Offsets and scales normalise: (value − off) / scale. The scales may be negative, never 0.
    `line_num`, `line_den`, `samp_num`, `samp_den` hold 20 coefficients each in RPC00B order.
    `image_shape` is (lines, samples) where it is known. `err_bias_m` and `err_rand_m` are the
    maker's 1-sigma errors; `fit_error_px` is how closely (line, sample) the coefficients follow
    the maker's own model.
    """

    line_off_px: float
    line_scale_px: float
    samp_off_px: float
    samp_scale_px: float
    lon_off_deg: float
    lon_scale_deg: float
    lat_off_deg: float
    lat_scale_deg: float
    height_off_m: float
    height_scale_m: float
    line_num: FloatArray
    line_den: FloatArray
    samp_num: FloatArray
    samp_den: FloatArray
    image_shape: tuple[int, int] | None = None
    err_bias_m: float | None = None
    err_rand_m: float | None = None
    fit_error_px: tuple[float, float] | None = None
    direct: DirectRpc | None = None
    validity: RpcValidity | None = None
    satellite: str = ""
    band: str = ""
    _coefficients: FloatArray = field(init=False, repr=False)
    _parameters: KernelParameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in _OFFS + _SCALES:
            value = float(getattr(self, name))
            if not math.isfinite(value):
                raise ArgumentError(f"{name}: a finite number expected, got {value}")
            if value == 0.0 and name in _SCALES:
                raise ArgumentError(f"{name}: a scale must not be zero")
            object.__setattr__(self, name, value)
        for name in ("line_num", "line_den", "samp_num", "samp_den"):
            object.__setattr__(self, name, twenty(getattr(self, name), name))
        if self.image_shape is not None:
            lines, samples = (int(n) for n in self.image_shape)
            if lines < 1 or samples < 1:
                raise ArgumentError(
                    f"image_shape: positive numbers expected, got {lines}, {samples}"
                )
            object.__setattr__(self, "image_shape", (lines, samples))
        coefficients = np.stack([self.line_num, self.line_den, self.samp_num, self.samp_den])
        half = np.array([0.5, 0.5])
        low = (-half - (self.line_off_px, self.samp_off_px)) / self._image_scale
        high = (self.shape - half - (self.line_off_px, self.samp_off_px)) / self._image_scale
        start = find_start(coefficients, (low[0], high[0]), (low[1], high[1]))
        if start is None:
            raise ArgumentError("coefficients: the polynomials have no inverse in mid-image")
        packed = np.concatenate([coefficients.ravel(), start.lon, start.lat])
        packed.setflags(write=False)
        object.__setattr__(self, "_coefficients", packed)
        object.__setattr__(self, "_parameters", self._pack(start))

    def __reduce__(self) -> tuple[Callable[..., RpcModel], tuple[object, ...]]:
        # Built anew, because pickled arrays come back writable.
        return type(self), tuple(getattr(self, f.name) for f in fields(self) if f.init)

    @property
    def _image_scale(self) -> FloatArray:
        return np.array([self.line_scale_px, self.samp_scale_px])

    def _pack(self, start: StartTable) -> KernelParameters:
        lines, samples = self.image_shape or (math.inf, math.inf)
        known = self.image_shape is not None
        scale_m = abs(self.height_scale_m)
        return KernelParameters(
            lon_off_rad=math.radians(self.lon_off_deg),
            lon_unit=math.degrees(1.0) / self.lon_scale_deg,
            lat_off_rad=math.radians(self.lat_off_deg),
            lat_unit=math.degrees(1.0) / self.lat_scale_deg,
            height_off_m=self.height_off_m,
            height_unit=1.0 / self.height_scale_m,
            line_off_px=self.line_off_px,
            line_scale_px=self.line_scale_px,
            samp_off_px=self.samp_off_px,
            samp_scale_px=self.samp_scale_px,
            line_low_px=-0.5 if known else -math.inf,
            line_high_px=lines - 0.5,
            samp_low_px=-0.5 if known else -math.inf,
            samp_high_px=samples - 0.5,
            line_den_unit=1.0 / start.line_den,
            samp_den_unit=1.0 / start.samp_den,
            lon_centre=start.lon_off,
            lon_half=start.lon_half,
            lat_centre=start.lat_off,
            lat_half=start.lat_half,
            height_centre=0.0,
            height_half=(scale_m + HEIGHT_MARGIN_M) / scale_m,
            start_line_off=start.line_off,
            start_line_unit=1.0 / start.line_half,
            start_samp_off=start.samp_off,
            start_samp_unit=1.0 / start.samp_half,
            start_height_off=0.0,
            start_height_unit=1.0,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Image size (lines, samples); worked out from offsets and scales where unknown.

        A maker who normalises lines 0 … n−1 to ±1 has off + scale = n − 1.
        """
        if self.image_shape is not None:
            return self.image_shape
        lines = round(self.line_off_px + abs(self.line_scale_px)) + 1
        samples = round(self.samp_off_px + abs(self.samp_scale_px)) + 1
        return max(lines, 1), max(samples, 1)

    @property
    def shape_known(self) -> bool:
        """Whether `shape` was stated; if not, no point is flagged as outside the image."""
        return self.image_shape is not None

    @property
    def height_range_m(self) -> tuple[float, float]:
        """Ellipsoidal heights the coefficients were fitted to: offset ± scale."""
        scale = abs(self.height_scale_m)
        return self.height_off_m - scale, self.height_off_m + scale

    def ground_to_image(self, geodetic: ArrayLike) -> ImagePoints:
        """Project `geodetic` (..., 3) = (lon_rad, lat_rad, height_m).

        Flags: `BAD_INPUT` for numbers that are not finite or a latitude beyond ±90°;
        `OUTSIDE_MODEL` where a denominator vanishes or changes sign, or the ground is further
        from the image than the image is wide (ratios of cubics repeat themselves far away);
        `OUTSIDE_IMAGE`, with numbers, outside a known image.
        """
        ground = as_components(geodetic, 3, "geodetic")
        shape = ground.shape[:-1]
        image_px = np.empty((*shape, 2))
        flags: FlagArray = np.empty(shape, dtype=np.uint8)
        project_points(
            _flat(ground),
            self._coefficients,
            self._parameters,
            image_px.reshape(-1),
            flags.reshape(-1),
        )
        return ImagePoints(image_px, flags)

    def image_to_ground(self, image_px: ArrayLike, height_m: ArrayLike) -> GroundPoints:
        """Locate `image_px` (..., 2) at ellipsoidal `height_m` (...), which broadcasts.

        Flags: `BAD_INPUT` for numbers that are not finite; `NOT_CONVERGED`; `OUTSIDE_MODEL` as
        in `ground_to_image`; `OUTSIDE_IMAGE`, with numbers, outside a known image.
        """
        image = as_components(image_px, 2, "image_px")
        heights = np.asarray(height_m, dtype=np.float64)
        if heights.ndim == 0:
            shape = image.shape[:-1]
            heights = _flat(heights)
        else:
            shape = _broadcast_shape(image.shape[:-1], heights.shape)
            image = np.broadcast_to(image, (*shape, 2))
            heights = _flat(np.broadcast_to(heights, shape))
        geodetic = np.empty((*shape, 3))
        flags: FlagArray = np.empty(shape, dtype=np.uint8)
        locate_points(
            _flat(image),
            heights,
            self._coefficients,
            self._parameters,
            geodetic.reshape(-1),
            flags.reshape(-1),
        )
        return GroundPoints(geodetic, flags)

    def rays(self, image_px: ArrayLike, height_m: ArrayLike) -> Rays:
        """Lines of sight of `image_px` (..., 2) through their points at `height_m` (...).

        The direction is the tangent, at that point, of the curve of all ground points with
        this image point: exact there, and no second inversion. An RPC does not know the
        satellite, so a ray begins where it is `RAY_ALTITUDE_M` above the point's horizontal
        plane: over all terrain, below any satellite.
        """
        ground = self.image_to_ground(image_px, height_m)
        origin, direction = np.empty_like(ground.geodetic), np.empty_like(ground.geodetic)
        sight_lines(
            _flat(ground.geodetic),
            self._coefficients,
            self._parameters,
            RAY_ALTITUDE_M,
            origin.reshape(-1),
            direction.reshape(-1),
        )
        return Rays(origin, direction, ground.flag)

    def jacobian(self, geodetic: ArrayLike) -> FloatArray:
        """d(line, sample)/d(lon_rad, lat_rad, height_m) at `geodetic` (..., 3): (..., 2, 3)."""
        ground = as_components(geodetic, 3, "geodetic")
        out = np.empty((*ground.shape[:-1], 2, 3))
        differentiate_points(
            _flat(ground).reshape(-1, 3),
            self._coefficients,
            self._parameters,
            out.reshape(-1, 2, 3),
        )
        return out

    def direct_image_to_ground(self, image_px: ArrayLike, height_m: ArrayLike) -> FloatArray:
        """Geodetic points (..., 3) from the maker's direct coefficients, for comparison.

        An `ArgumentError` where the model carries none.
        """
        if self.direct is None:
            raise ArgumentError("direct: this RPC has no direct (image to ground) coefficients")
        image = as_components(image_px, 2, "image_px")
        line, samp, height = np.broadcast_arrays(image[..., 0], image[..., 1], height_m)
        ground = self.direct.normalised_ground(
            (line - self.line_off_px) / self.line_scale_px,
            (samp - self.samp_off_px) / self.samp_scale_px,
            (height - self.height_off_m) / self.height_scale_m,
        )
        lon_deg = self.lon_off_deg + self.lon_scale_deg * ground[..., 0]
        lon_deg = lon_deg - 360.0 * np.rint(lon_deg / 360.0)
        lat_deg = self.lat_off_deg + self.lat_scale_deg * ground[..., 1]
        return np.stack([np.radians(lon_deg), np.radians(lat_deg), height], axis=-1)

    def with_shape(self, shape: tuple[int, int]) -> RpcModel:
        """Return the same model with a known image size (lines, samples)."""
        return replace(self, image_shape=shape)

    def shifted(self, line_px: float, samp_px: float) -> RpcModel:
        """Return the model whose image points are moved by (`line_px`, `samp_px`)."""
        validity = self.validity
        if validity is not None:
            validity = replace(
                validity,
                line_px=(validity.line_px[0] + line_px, validity.line_px[1] + line_px),
                samp_px=(validity.samp_px[0] + samp_px, validity.samp_px[1] + samp_px),
            )
        return replace(
            self,
            line_off_px=self.line_off_px + line_px,
            samp_off_px=self.samp_off_px + samp_px,
            validity=validity,
        )

    def cropped(self, first_line: int, first_sample: int, shape: tuple[int, int]) -> RpcModel:
        """Return the model of the window of `shape` whose first pixel is (first_line, ...)."""
        return self.shifted(-first_line, -first_sample).with_shape(shape)


def _flat(array: FloatArray) -> FloatArray:
    """Read-only view (or copy) in one dimension: one type, so kernels are compiled once."""
    flat = np.ascontiguousarray(array).reshape(-1)
    flat.setflags(write=False)
    return flat


def _broadcast_shape(a: tuple[int, ...], b: tuple[int, ...]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(a, b)
    except ValueError:
        raise ArgumentError(
            f"height_m: shape {b} does not go with image points of shape {a}"
        ) from None
