"""Adjusted models: the same models with corrected parts, so that all else goes on working.

A rigorous model gets a corrected attitude (the given one turned further by its correction),
ephemeris, times and camera; an RPC a bias folded into its coefficients; any other model a
bias in its image.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.adjust.residuals import image_plane, look_ends, sample_powers
from geoposition.adjust.unknowns import Block
from geoposition.arrays import FloatArray, read_only
from geoposition.attitude import Attitude, EulerCurve, ProductCurve, RotationCurve
from geoposition.camera import Camera, Detector, LineTiming
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError
from geoposition.interpolation import SumCurve
from geoposition.pushbroom import PushbroomModel
from geoposition.rays import Rays
from geoposition.rpc.model import RpcModel
from geoposition.rpc.transform import ImageAffine, bias_compensated
from geoposition.sensor_model import GroundPoints, ImagePoints, SensorModel

_RPC_MISFIT_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class LookCorrection:
    """Polynomials `tangents_rad` (degree + 1, 2) in s, the sample from −1 to 1 between `ends`.

    Of CCD number `detector`, or of the whole row.
    """

    tangents_rad: FloatArray
    ends: tuple[float, float]
    detector: int | None = None

    def at(self, detector: int, sample: FloatArray) -> FloatArray:
        """Return what adds to the tangents (..., 2) of `sample` (...) seen by a CCD."""
        if self.detector not in (None, detector):
            return np.zeros((*sample.shape, 2))
        powers = sample_powers(sample.ravel(), self.ends, len(self.tangents_rad) - 1)
        added: FloatArray = (powers @ self.tangents_rad).reshape(*sample.shape, 2)
        return added


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedCamera:
    """A camera with polynomials added to its tangents, and a turned mounting; a `Camera`."""

    base: Camera
    looks: tuple[LookCorrection, ...]
    turn: Rotation

    @property
    def shape(self) -> tuple[int, int]:
        """Image size (lines, samples)."""
        return self.base.shape

    @property
    def timing(self) -> LineTiming:
        """Line to time."""
        return self.base.timing

    @property
    def detectors(self) -> tuple[Detector, ...]:
        """The CCDs by increasing sample."""
        return self.base.detectors

    def tangents(self, detector: int, sample: ArrayLike) -> FloatArray:
        """Corrected tangents (..., 2) of `sample` (...)."""
        samples = np.asarray(sample, dtype=np.float64)
        result: FloatArray = self.base.tangents(detector, samples)
        for look in self.looks:
            result = result + look.at(detector, samples)
        return result

    @property
    def R_body_camera(self) -> Rotation:
        """Mounting: camera frame to body frame, corrected."""
        return self.base.R_body_camera * self.turn

    @property
    def lever_arm_body_m(self) -> FloatArray:
        """Perspective centre relative to the ephemeris's point, body frame (3,)."""
        return self.base.lever_arm_body_m

    @property
    def parameters(self) -> Mapping[str, float]:
        """Parameters of the camera underneath."""
        return self.base.parameters

    def with_parameters(self, values: Mapping[str, float]) -> Self:
        """Camera with some parameters of the one underneath changed."""
        return replace(self, base=self.base.with_parameters(values))


@dataclass(frozen=True, slots=True, eq=False)
class ImageBiasModel:
    """Any model whose image points are moved by `affine`: new of its own; a `SensorModel`."""

    base: SensorModel
    affine: ImageAffine

    @property
    def shape(self) -> tuple[int, int]:
        """Image size (lines, samples)."""
        return self.base.shape

    @property
    def height_range_m(self) -> tuple[float, float]:
        """Heights the model underneath is meant for."""
        return self.base.height_range_m

    def image_to_ground(self, image_px: ArrayLike, height_m: ArrayLike) -> GroundPoints:
        """Locate `image_px` (..., 2) at `height_m` (...)."""
        return self.base.image_to_ground(self.affine.undo(image_px), height_m)

    def ground_to_image(self, geodetic: ArrayLike) -> ImagePoints:
        """Project `geodetic` (..., 3)."""
        found = self.base.ground_to_image(geodetic)
        return ImagePoints(self.affine.apply(found.image_px), found.flag)

    def rays(self, image_px: ArrayLike, height_m: ArrayLike) -> Rays:
        """Lines of sight of `image_px` (..., 2)."""
        return self.base.rays(self.affine.undo(image_px), height_m)


def corrected(
    model: SensorModel, blocks: Sequence[Block], values: Sequence[FloatArray]
) -> SensorModel:
    """Return `model` with the unknowns of its `blocks` at `values`; without blocks, itself.

    A rigorous model stays one (with an image block it is one inside an `ImageBiasModel`), an RPC
    stays an RPC where its coefficients can hold the bias to 0.001 px.
    """
    by_kind = list(zip(blocks, values, strict=True))
    result = model
    if isinstance(model, PushbroomModel) and any(b.kind != "image" for b in blocks):
        result = _rigorous(model, [(b, v) for b, v in by_kind if b.kind != "image"])
    for block, value in by_kind:
        if block.kind == "image":
            result = _image_moved(result, image_plane(value, model.shape))
    return result


def _image_moved(model: SensorModel, plane: FloatArray) -> SensorModel:
    bias = plane if np.any(plane[:, 1:]) else plane[:, 0]
    if isinstance(model, RpcModel):
        folded = bias_compensated(model, bias)
        if folded.misfit_px is None or folded.misfit_px <= _RPC_MISFIT_PX:
            return folded.model
    return ImageBiasModel(model, ImageAffine.correction(bias))


def _rigorous(model: PushbroomModel, parts: list[tuple[Block, FloatArray]]) -> PushbroomModel:
    camera, ephemeris, attitude = model.camera, model.ephemeris, model.attitude
    turn = Rotation.identity()
    looks: list[LookCorrection] = []
    offset_s = 0.0
    curve: RotationCurve = attitude.curve
    positions = ephemeris.curve
    for block, values in parts:
        if block.kind == "attitude":
            assert block.basis is not None
            angles = block.basis.curve(values.reshape(-1, 3), attitude.epoch, attitude.span_s)
            curve = ProductCurve(curve, EulerCurve(angles, "XYZ"))
        elif block.kind == "orbit":
            assert block.basis is not None
            moved = values.reshape(-1, 3) @ block.axes_ecef.T
            positions = SumCurve(
                positions, block.basis.curve(moved, ephemeris.epoch, ephemeris.span_s)
            )
        elif block.kind == "mounting":
            turn = turn * Rotation.from_rotvec(values)
        elif block.kind == "look":
            ends = look_ends(block, camera)
            looks.append(LookCorrection(read_only(values.reshape(-1, 2)), ends, block.detector))
        elif block.kind == "time":
            offset_s += float(values[0])
        else:
            raise ArgumentError(f"{block.name}: no part of a rigorous model")
    # All lines later by an offset: attitude and orbit earlier by it.
    return PushbroomModel(
        _camera(camera, turn, tuple(looks)),
        Ephemeris(ephemeris.epoch - offset_s, positions, ephemeris.frame),
        Attitude(attitude.epoch - offset_s, curve, attitude.frame),
        model.corrections,
        model.height_range_m,
    )


def _camera(camera: Camera, turn: Rotation, looks: tuple[LookCorrection, ...]) -> Camera:
    rotvec = turn.as_rotvec()
    names = [f"mounting_{axis}_rad" for axis in "xyz"]
    if not any(np.any(look.tangents_rad) for look in looks):
        if not np.any(rotvec):
            return camera
        if set(names) <= set(camera.parameters):
            return camera.with_parameters(dict(zip(names, rotvec.tolist(), strict=True)))
    return CorrectedCamera(camera, looks, turn)
