"""A model changed by a constant so that its image points move: a bias taken out for good.

Of an RPC it is the offsets that change. A rigorous model is turned: by the smallest constant
turn in the body frame that moves its image points as asked, hence none about the line of sight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Protocol, Self, runtime_checkable

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import ProductCurve, RotationCurve
from geoposition.error_budget.image_scale import image_scale_at
from geoposition.error_budget.influence import influence
from geoposition.errors import ArgumentError, GeometryError
from geoposition.flags import has_result
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel

_TURNS: Final = 3
_MOST_POINTS: Final = 500


@runtime_checkable
class Shiftable(Protocol):
    """A model that can move its own image points, as an RPC can."""

    def shifted(self, line_px: float, samp_px: float) -> Self:
        """Return the model whose image points are moved by (`line_px`, `samp_px`)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ConstantTurn:
    """One rotation at all times that `like` covers; a `RotationCurve`."""

    like: RotationCurve
    rotvec_rad: FloatArray

    @property
    def span_s(self) -> tuple[float, float]:
        """Span of `like`."""
        return self.like.span_s

    @property
    def knots_s(self) -> FloatArray:
        """Knots of `like`."""
        return self.like.knots_s

    def rotation(self, times_s: FloatArray) -> Rotation:
        """Return the same rotation at `times_s` (n,)."""
        return Rotation.from_rotvec(np.tile(self.rotvec_rad, (len(times_s), 1)))


@dataclass(frozen=True, slots=True, eq=False)
class Mended:
    """A changed `model`; `turn_rad` (3,) about the body axes if that is what changed it."""

    model: SensorModel
    turn_rad: FloatArray | None = None


def turned(model: PushbroomModel, turn_rad: FloatArray) -> PushbroomModel:
    """Return the model with its attitude R exp(d), d = `turn_rad` (3,) in the body frame."""
    attitude = model.attitude
    curve = ProductCurve(attitude.curve, ConstantTurn(attitude.curve, np.array(turn_rad)))
    return replace(model, attitude=replace(attitude, curve=curve))


def mended(
    model: SensorModel, shift_px: FloatArray, image_px: FloatArray, height_m: FloatArray
) -> Mended:
    """Return `model` with its image points moved by `shift_px` (2,).

    For a rigorous model, on average over `image_px` (n, 2) at heights (n,): those at which the
    shift was found.
    """
    if not np.any(shift_px):
        return Mended(model)
    if isinstance(model, PushbroomModel):
        step = max(1, len(image_px) // _MOST_POINTS)
        return _turned_by(model, shift_px, image_px[::step], height_m[::step])
    if isinstance(model, Shiftable):
        return Mended(model.shifted(float(shift_px[0]), float(shift_px[1])))
    raise ArgumentError(f"bias: a {type(model).__name__} cannot be moved")


def _turned_by(
    model: PushbroomModel, shift_px: FloatArray, image_px: FloatArray, height_m: FloatArray
) -> Mended:
    ground = model.image_to_ground(image_px, height_m)
    seen = has_result(ground.flag)
    scale = image_scale_at(model, image_px, height_m)
    good = seen & scale.good
    if not good.any():
        raise GeometryError("bias: the model sees no ground where the bias was found")
    moves = influence(model, image_px[good], height_m[good])
    per_rad = np.mean(scale.image_per_m[good] @ moves.turn_body_m, axis=0)
    inverse = np.linalg.pinv(per_rad)
    turn, found = np.zeros(3), model
    for _ in range(_TURNS):
        now = found.ground_to_image(ground.geodetic[good])
        off = np.nanmean(now.image_px - image_px[good], axis=0) - shift_px
        # A turn d moves the ground of a pixel by G d, hence the image of a place by −J G d.
        turn = turn + inverse @ off
        found = turned(model, turn)
    return Mended(found, turn)
