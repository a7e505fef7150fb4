"""New RPCs from old ones: image-space corrections, overviews, mosaics, turned images.

All are affine in the image: new = B old + b, with image points as (line, sample). A row of B with
one number other than zero only rescales one ratio, and ratios over one denominator can be added:
both are exact. Ratios over two different denominators have no sum among ratios of cubics; then
new ones are fitted, and the fit's error is stated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, as_components, read_only
from geoposition.errors import ArgumentError
from geoposition.rays import Rays
from geoposition.rpc.direct import DirectRpc
from geoposition.rpc.fit import fit_model
from geoposition.rpc.fit_basis import substitution
from geoposition.rpc.model import RpcModel, RpcValidity
from geoposition.sensor_model import GroundPoints, ImagePoints


@dataclass(frozen=True, slots=True, eq=False)
class ImageAffine:
    """new = `matrix` (2, 2) old + `shift_px` (2), image points as (line, sample)."""

    matrix: FloatArray
    shift_px: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", read_only(self.matrix))
        object.__setattr__(self, "shift_px", read_only(self.shift_px))
        if self.matrix.shape != (2, 2) or self.shift_px.shape != (2,):
            raise ArgumentError("image affine: a matrix (2, 2) and a shift (2) expected")
        numbers = np.concatenate([self.matrix.ravel(), self.shift_px])
        if not np.all(np.isfinite(numbers)) or abs(np.linalg.det(self.matrix)) < 1e-9:
            raise ArgumentError("image affine: finite numbers and an invertible matrix expected")

    @classmethod
    def correction(cls, bias_px: ArrayLike) -> ImageAffine:
        """Add a bias: (line, sample) shifts (2), or rows (1, line, sample) (2, 3) of a plane."""
        bias = np.asarray(bias_px, dtype=np.float64)
        if bias.shape == (2,):
            return cls(np.eye(2), bias)
        if bias.shape == (2, 3):
            return cls(np.eye(2) + bias[:, 1:], bias[:, 0])
        raise ArgumentError(f"bias: shape (2) or (2, 3) expected, got {bias.shape}")

    @classmethod
    def overview(cls, factor: float) -> ImageAffine:
        """Pixels `factor` times as large, the image's corner where it was."""
        if not factor > 0.0:
            raise ArgumentError(f"overview: a positive factor expected, got {factor}")
        return cls(np.eye(2) / factor, np.full(2, 0.5 / factor - 0.5))

    @classmethod
    def quarter_turns(cls, turns: int, shape: tuple[int, int]) -> ImageAffine:
        """Turn an image of `shape` by quarters counter-clockwise, as `numpy.rot90` does."""
        lines, samples = shape
        quarter = turns % 4
        if quarter == 1:
            return cls(np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([samples - 1.0, 0.0]))
        if quarter == 2:
            return cls(-np.eye(2), np.array([lines - 1.0, samples - 1.0]))
        if quarter == 3:
            return cls(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([0.0, lines - 1.0]))
        return cls(np.eye(2), np.zeros(2))

    def apply(self, image_px: ArrayLike) -> FloatArray:
        """Return new image points of old ones (..., 2)."""
        result: FloatArray = as_components(image_px, 2, "image_px") @ self.matrix.T + self.shift_px
        return result

    def undo(self, image_px: ArrayLike) -> FloatArray:
        """Old image points of new ones (..., 2)."""
        inverse = np.linalg.inv(self.matrix)
        result: FloatArray = (as_components(image_px, 2, "image_px") - self.shift_px) @ inverse.T
        return result


@dataclass(frozen=True, slots=True)
class Transformed:
    """A transformed RPC; `misfit_px` is the largest error of a refit, None where it is exact."""

    model: RpcModel
    misfit_px: float | None


def bias_compensated(rpc: RpcModel, bias_px: ArrayLike) -> Transformed:
    """Fold an image-space bias, observed − RPC, into new coefficients.

    `bias_px` is a shift (line, sample), which is exact, or (2, 3): the rows line and sample,
    each as constant, per line, per sample; exact where the shape of the formula or of the
    denominators allows it.
    """
    return transformed(rpc, ImageAffine.correction(bias_px), rpc.image_shape)


def transformed(
    rpc: RpcModel, affine: ImageAffine, shape: tuple[int, int] | None = None
) -> Transformed:
    """RPC of the image whose points are `affine` of those of `rpc`; `shape` is its size."""
    if np.all(np.count_nonzero(affine.matrix, axis=1) == 1):
        return Transformed(_rescaled(rpc, affine, shape), None)
    if np.array_equal(rpc.line_den, rpc.samp_den):
        return Transformed(_recombined(rpc, affine, shape), None)
    moved = _Moved(rpc, affine, shape or rpc.shape)
    fit = fit_model(moved, direct=rpc.direct is not None)
    assert fit.check is not None
    model = replace(
        fit.model,
        image_shape=shape,
        err_bias_m=rpc.err_bias_m,
        err_rand_m=rpc.err_rand_m,
        satellite=rpc.satellite,
        band=rpc.band,
    )
    return Transformed(model, fit.check.largest_px)


def _rescaled(rpc: RpcModel, affine: ImageAffine, shape: tuple[int, int] | None) -> RpcModel:
    """Each new axis is one old one, scaled and moved: only the normalisation changes."""
    source = np.argmax(np.abs(affine.matrix), axis=1)
    factor = affine.matrix[np.arange(2), source]
    off = affine.matrix @ (rpc.line_off_px, rpc.samp_off_px) + affine.shift_px
    scale = np.abs(factor) * np.array([rpc.line_scale_px, rpc.samp_scale_px])[source]
    sign = np.sign(factor)
    num, den = (rpc.line_num, rpc.samp_num), (rpc.line_den, rpc.samp_den)
    return replace(
        rpc,
        line_off_px=off[0],
        samp_off_px=off[1],
        line_scale_px=scale[0],
        samp_scale_px=scale[1],
        line_num=sign[0] * num[source[0]],
        line_den=den[source[0]],
        samp_num=sign[1] * num[source[1]],
        samp_den=den[source[1]],
        image_shape=shape,
        fit_error_px=_error(rpc, affine),
        direct=_turned_direct(rpc.direct, source, sign),
        validity=_moved_validity(rpc.validity, affine),
    )


def _turned_direct(
    direct: DirectRpc | None, source: np.ndarray[tuple[int], np.dtype[np.intp]], sign: FloatArray
) -> DirectRpc | None:
    if direct is None or (source[0] == 0 and np.all(sign > 0.0)):
        return direct
    # Old (sample, line, height) of the new ones.
    matrix = np.zeros((3, 3))
    matrix[2, 2] = 1.0
    for new in range(2):
        matrix[1 - source[new], 1 - new] = sign[new]
    back = substitution(matrix, np.zeros(3))
    names = ("lon_num", "lon_den", "lat_num", "lat_den")
    parts = {name: back @ getattr(direct, name) for name in names}
    return DirectRpc(**parts, fit_error_m=direct.fit_error_m)


def _recombined(rpc: RpcModel, affine: ImageAffine, shape: tuple[int, int] | None) -> RpcModel:
    """With one denominator D, new N/D = (c D + a N_line + b N_sample) / D."""
    off = np.array([rpc.line_off_px, rpc.samp_off_px])
    scale = np.array([rpc.line_scale_px, rpc.samp_scale_px])
    new_off = affine.matrix @ off + affine.shift_px
    new_scale = np.abs(affine.matrix) @ np.abs(scale)
    share = affine.matrix * scale / new_scale[:, None]
    num = share @ np.stack([rpc.line_num, rpc.samp_num])
    return replace(
        rpc,
        line_off_px=new_off[0],
        samp_off_px=new_off[1],
        line_scale_px=new_scale[0],
        samp_scale_px=new_scale[1],
        line_num=num[0],
        samp_num=num[1],
        image_shape=shape,
        fit_error_px=_error(rpc, affine),
        direct=None,
        validity=_moved_validity(rpc.validity, affine),
    )


def _error(rpc: RpcModel, affine: ImageAffine) -> tuple[float, float] | None:
    if rpc.fit_error_px is None:
        return None
    error = np.sqrt(affine.matrix**2 @ np.square(rpc.fit_error_px))
    return float(error[0]), float(error[1])


def _moved_validity(validity: RpcValidity | None, affine: ImageAffine) -> RpcValidity | None:
    if validity is None:
        return None
    corners = np.array([[line, samp] for line in validity.line_px for samp in validity.samp_px])
    moved = affine.apply(corners)
    low, high = moved.min(axis=0).tolist(), moved.max(axis=0).tolist()
    return replace(validity, line_px=(low[0], high[0]), samp_px=(low[1], high[1]))


@dataclass(frozen=True, slots=True)
class _Moved:
    """The transformed model as it is, to be fitted."""

    rpc: RpcModel
    affine: ImageAffine
    shape: tuple[int, int]

    @property
    def height_range_m(self) -> tuple[float, float]:
        return self.rpc.height_range_m

    def image_to_ground(self, image_px: ArrayLike, height_m: ArrayLike) -> GroundPoints:
        return self.rpc.image_to_ground(self.affine.undo(image_px), height_m)

    def ground_to_image(self, geodetic: ArrayLike) -> ImagePoints:
        found = self.rpc.ground_to_image(geodetic)
        return ImagePoints(self.affine.apply(found.image_px), found.flag)

    def rays(self, image_px: ArrayLike, height_m: ArrayLike) -> Rays:
        return self.rpc.rays(self.affine.undo(image_px), height_m)
