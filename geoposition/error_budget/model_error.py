"""A model's own errors, stated by their covariances, as errors of the image points.

An error of orbit or attitude is common to all points of an image, or nearly so: it does not
average out over them. What it does to one image point is a covariance in pixels like that of
the measurement, J G C Gᵀ Jᵀ, with G the movement on the ground (`influence`) and J pixels per
metre (`image_scale`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, read_only
from geoposition.ellipsoid import enu_axes
from geoposition.error_budget.image_scale import image_scale_at
from geoposition.error_budget.influence import influence
from geoposition.errors import ArgumentError
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel


def _zeros(size: int) -> FloatArray:
    return np.zeros((size, size))


@dataclass(frozen=True, slots=True, eq=False)
class ModelError:
    """Covariances of one model's constant errors, independent of one another and of other images.

    `attitude_rad2` (3, 3) of the turn in the body frame, R exp(d); `position_m2` (3, 3) of the
    satellite's position along the orbit's axes (along track, left, up); `image_px2` (2, 2) of a
    shift of (line, sample), such as an RPC's misfit; `ground_m` the standard deviation, per
    horizontal axis, of located points, as RPC files state it (errBias). The first two are for
    rigorous models alone.
    """

    attitude_rad2: FloatArray = field(default_factory=lambda: _zeros(3))
    position_m2: FloatArray = field(default_factory=lambda: _zeros(3))
    image_px2: FloatArray = field(default_factory=lambda: _zeros(2))
    ground_m: float = 0.0

    def __post_init__(self) -> None:
        for name, size in (("attitude_rad2", 3), ("position_m2", 3), ("image_px2", 2)):
            value = read_only(getattr(self, name))
            if value.shape != (size, size) or not np.all(np.isfinite(value)):
                raise ArgumentError(f"model error: {name}: ({size}, {size}) finite expected")
            scale = float(np.abs(value).max())
            lopsided = np.abs(value - value.T).max() > 1e-9 * scale
            if lopsided or np.linalg.eigvalsh(value)[0] < -1e-9 * scale:
                raise ArgumentError(f"model error: {name}: a covariance expected")
            object.__setattr__(self, name, value)
        if not (np.isfinite(self.ground_m) and self.ground_m >= 0.0):
            raise ArgumentError(f"model error: ground_m: metres expected, got {self.ground_m}")

    @classmethod
    def of_sigmas(
        cls,
        attitude_rad: ArrayLike = 0.0,
        position_m: ArrayLike = 0.0,
        image_px: ArrayLike = 0.0,
        ground_m: float = 0.0,
    ) -> ModelError:
        """Independent errors by their standard deviations, each one number or one per axis."""
        return cls(_diagonal(attitude_rad, 3), _diagonal(position_m, 3),
                   _diagonal(image_px, 2), float(ground_m))  # fmt: skip

    @property
    def needs_orbit(self) -> bool:
        """Whether only a rigorous model can have these errors."""
        return bool(np.any(self.attitude_rad2) or np.any(self.position_m2))

    @property
    def nothing(self) -> bool:
        """Whether all errors are zero."""
        return not (self.needs_orbit or np.any(self.image_px2) or self.ground_m)


def image_error_covariance(
    model: SensorModel, error: ModelError, image_px: FloatArray, height_m: FloatArray
) -> FloatArray:
    """Covariance (n, 2, 2) in px² of image points (n, 2) at heights (n,), from `error` alone.

    NaN where the model has no result. An `ArgumentError` where errors of orbit or attitude are
    stated for a model that has neither.
    """
    out = np.broadcast_to(error.image_px2, (len(image_px), 2, 2)).copy()
    scale = image_scale_at(model, image_px, height_m)
    if error.needs_orbit:
        if not isinstance(model, PushbroomModel):
            raise ArgumentError(
                "model error: attitude and orbit errors are for rigorous models; "
                "state those of an RPC in pixels or on the ground"
            )
        moves = influence(model, image_px, height_m)
        for gain, covariance in (
            (moves.turn_body_m, error.attitude_rad2),
            (moves.position_m, error.position_m2),
        ):
            px = scale.image_per_m @ gain
            out += px @ covariance @ px.transpose(0, 2, 1)
    if error.ground_m:
        ground = model.image_to_ground(image_px, height_m).geodetic
        level = enu_axes(np.where(scale.good[:, None], ground, 0.0))[:, :, :2]
        px = error.ground_m * scale.image_per_m @ level
        out += px @ px.transpose(0, 2, 1)
    out[~scale.good] = np.nan
    return out


def _diagonal(sigma: ArrayLike, size: int) -> FloatArray:
    values = np.asarray(sigma, dtype=np.float64)
    if values.shape not in ((), (size,)) or not np.all(np.isfinite(values) & (values >= 0.0)):
        raise ArgumentError(f"model error: one sigma or {size} expected, got {values}")
    return np.diag(np.broadcast_to(values**2, (size,)))
