"""Sample to direction: look-angle polynomials and tables, and the collinear line camera.

Each gives the apparent direction in the camera frame as tangents (x, y): d is along (x, y, 1),
z being the optical axis. Products with other axes turn them by the mounting.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from geoposition.arrays import FloatArray, read_only, require_finite
from geoposition.errors import ArgumentError

_MAX_TANGENT = 10.0
"""Beyond it (84 degrees off the axis) no line camera looks: a unit or a sign is wrong."""


class Directions(Protocol):
    """Directions of the samples of one CCD."""

    @property
    def knots_sample(self) -> FloatArray:
        """Samples at which a derivative jumps; empty for a smooth curve."""
        ...

    @property
    def parameters(self) -> dict[str, float]:
        """Estimable parameters by name."""
        ...

    def with_parameters(self, values: dict[str, float]) -> Self:
        """Return the same with some parameters changed."""
        ...

    def tangents(self, sample: ArrayLike) -> FloatArray:
        """Tangents (..., 2) of `sample` (...)."""
        ...


def _polynomial(coefficients: FloatArray, s: FloatArray) -> FloatArray:
    return np.asarray(np.polynomial.polynomial.polyval(s, coefficients), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialDirections:
    """Polynomials x(s), y(s) in s = (sample − `offset`) / `scale`, ascending coefficients.

    `angles` tells that they give angles psi, whose tangents are taken (P 9–10, degree 3 there);
    otherwise they are the tangents themselves (DIMAP v2).
    """

    x_coefficients: FloatArray
    y_coefficients: FloatArray
    offset: float = 0.0
    scale: float = 1.0
    angles: bool = False

    def __post_init__(self) -> None:
        for name in ("x_coefficients", "y_coefficients"):
            table = require_finite(read_only(getattr(self, name)), f"look angles: {name}")
            if table.ndim != 1 or not len(table):
                raise ArgumentError(f"look angles: {name}: a list of coefficients expected")
            object.__setattr__(self, name, table)
        if not (np.isfinite(self.offset) and np.isfinite(self.scale) and self.scale != 0):
            raise ArgumentError("look angles: finite offset and a scale other than 0 expected")

    @property
    def knots_sample(self) -> FloatArray:
        """None: polynomials are smooth."""
        return np.empty(0)

    @property
    def parameters(self) -> dict[str, float]:
        """Coefficients `x0`, `x1`, ..., `y0`, ...."""
        named = {f"x{i}": float(c) for i, c in enumerate(self.x_coefficients)}
        return named | {f"y{i}": float(c) for i, c in enumerate(self.y_coefficients)}

    def with_parameters(self, values: dict[str, float]) -> Self:
        """Return the same with some coefficients changed."""
        all_values = self.parameters | values
        if len(all_values) != len(self.parameters):
            raise ArgumentError(f"look angles: no parameter {set(values) - set(self.parameters)}")
        return replace(
            self,
            x_coefficients=np.array([all_values[f"x{i}"] for i in range(len(self.x_coefficients))]),
            y_coefficients=np.array([all_values[f"y{i}"] for i in range(len(self.y_coefficients))]),
        )

    def tangents(self, sample: ArrayLike) -> FloatArray:
        """Tangents (..., 2) of `sample` (...)."""
        s = (np.asarray(sample, dtype=np.float64) - self.offset) / self.scale
        values = np.stack(
            [_polynomial(self.x_coefficients, s), _polynomial(self.y_coefficients, s)], axis=-1
        )
        return np.tan(values) if self.angles else values


@dataclass(frozen=True, slots=True, eq=False)
class TableDirections:
    """Tangents (n, 2) at the samples (n,), linear between them and beyond the ends.

    Full tables hold one entry per sample (SPOT 5); two entries make a straight line of
    directions (SPOT 1-4).
    """

    samples: FloatArray
    table: FloatArray

    def __post_init__(self) -> None:
        samples = require_finite(read_only(self.samples), "look-angle table: samples")
        table = require_finite(read_only(self.table), "look-angle table: tangents")
        if samples.ndim != 1 or len(samples) < 2 or table.shape != (len(samples), 2):
            raise ArgumentError("look-angle table: two or more samples, each with 2 tangents")
        if np.any(np.diff(samples) <= 0):
            raise ArgumentError("look-angle table: strictly increasing samples expected")
        if np.max(np.abs(table)) > _MAX_TANGENT:
            raise ArgumentError("look-angle table: a direction lies over 84 deg off the axis")
        object.__setattr__(self, "samples", samples)
        object.__setattr__(self, "table", table)

    @property
    def knots_sample(self) -> FloatArray:
        """Inner samples of the table."""
        return self.samples[1:-1]

    @property
    def parameters(self) -> dict[str, float]:
        """Two shifts `dx`, `dy`, zero by construction: a table is calibrated as a whole."""
        return {"dx": 0.0, "dy": 0.0}

    def with_parameters(self, values: dict[str, float]) -> Self:
        """Return the same table, shifted by `dx`, `dy`."""
        if set(values) - {"dx", "dy"}:
            raise ArgumentError(f"look-angle table: no parameter {set(values) - {'dx', 'dy'}}")
        shift = np.array([values.get("dx", 0.0), values.get("dy", 0.0)])
        return replace(self, table=self.table + shift)

    def tangents(self, sample: ArrayLike) -> FloatArray:
        """Tangents (..., 2) of `sample` (...)."""
        s = np.asarray(sample, dtype=np.float64)
        k = np.clip(np.searchsorted(self.samples, s, side="right") - 1, 0, len(self.samples) - 2)
        step = self.samples[k + 1] - self.samples[k]
        part = ((s - self.samples[k]) / step)[..., None]
        result: FloatArray = self.table[k] * (1 - part) + self.table[k + 1] * part
        return result


@dataclass(frozen=True, slots=True)
class CollinearDirections:
    """Straight CCD in the focal plane of a camera (T 2.1–2.2), with lens distortion.

    Sample s lies at `detector_origin` + R(`detector_rotation_rad`) (`pitch_x`, `pitch_y`) s in
    the focal plane; the principal point is subtracted, distortion r (k1 r^2 + k2 r^4) removed,
    and the result divided by the focal length. All lengths in one unit, such as mm.
    """

    focal_length: float
    detector_origin: tuple[float, float]
    pitch: tuple[float, float]
    detector_rotation_rad: float = 0.0
    principal_point: tuple[float, float] = (0.0, 0.0)
    radial: tuple[float, ...] = field(default=())

    def __post_init__(self) -> None:
        numbers = [self.focal_length, self.detector_rotation_rad, *self.detector_origin]
        numbers += [*self.pitch, *self.principal_point, *self.radial]
        if not np.all(np.isfinite(numbers)):
            raise ArgumentError("collinear camera: finite numbers expected")
        if self.focal_length <= 0 or not any(self.pitch):
            raise ArgumentError("collinear camera: a positive focal length and a pitch expected")

    @property
    def knots_sample(self) -> FloatArray:
        """None: a straight detector is smooth."""
        return np.empty(0)

    @property
    def parameters(self) -> dict[str, float]:
        """Focal length, principal point, detector rotation and distortion by name."""
        named = {
            "focal_length": self.focal_length,
            "principal_point_x": self.principal_point[0],
            "principal_point_y": self.principal_point[1],
            "detector_rotation_rad": self.detector_rotation_rad,
        }
        return named | {f"k{i + 1}": k for i, k in enumerate(self.radial)}

    def with_parameters(self, values: dict[str, float]) -> Self:
        """Return the same with some parameters changed."""
        new = self.parameters | values
        if len(new) != len(self.parameters):
            unknown = set(values) - set(self.parameters)
            raise ArgumentError(f"collinear camera: no parameter {unknown}")
        return replace(
            self,
            focal_length=new["focal_length"],
            principal_point=(new["principal_point_x"], new["principal_point_y"]),
            detector_rotation_rad=new["detector_rotation_rad"],
            radial=tuple(new[f"k{i + 1}"] for i in range(len(self.radial))),
        )

    def tangents(self, sample: ArrayLike) -> FloatArray:
        """Tangents (..., 2) of `sample` (...)."""
        s = np.asarray(sample, dtype=np.float64)
        c, d = np.cos(self.detector_rotation_rad), np.sin(self.detector_rotation_rad)
        step_x = c * self.pitch[0] - d * self.pitch[1]
        step_y = d * self.pitch[0] + c * self.pitch[1]
        x = self.detector_origin[0] + step_x * s - self.principal_point[0]
        y = self.detector_origin[1] + step_y * s - self.principal_point[1]
        plane = np.stack([x, y], axis=-1) / self.focal_length
        if self.radial:
            r2 = np.sum(plane**2, axis=-1, keepdims=True)
            distortion = np.zeros_like(r2)
            for k in self.radial[::-1]:
                distortion = (distortion + k) * r2
            plane = plane * (1.0 - distortion)
        return plane


@dataclass(frozen=True, slots=True, eq=False)
class SplineDirections:
    """Smooth curve of tangents (n, 2) through samples (n,): calibrated nodes, n >= 4."""

    samples: FloatArray
    table: FloatArray
    _spline: CubicSpline = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        checked = TableDirections(self.samples, self.table)
        if len(checked.samples) < 4:
            raise ArgumentError("look-angle spline: at least 4 nodes expected")
        object.__setattr__(self, "samples", checked.samples)
        object.__setattr__(self, "table", checked.table)
        object.__setattr__(self, "_spline", CubicSpline(checked.samples, checked.table, axis=0))

    @property
    def knots_sample(self) -> FloatArray:
        """The inner nodes."""
        return self.samples[1:-1]

    @property
    def parameters(self) -> dict[str, float]:
        """Two shifts `dx`, `dy`, zero by construction."""
        return {"dx": 0.0, "dy": 0.0}

    def with_parameters(self, values: dict[str, float]) -> Self:
        """Return the same curve, shifted by `dx`, `dy`."""
        shifted = TableDirections(self.samples, self.table).with_parameters(values)
        return type(self)(self.samples, shifted.table)

    def tangents(self, sample: ArrayLike) -> FloatArray:
        """Tangents (..., 2) of `sample` (...)."""
        result: FloatArray = self._spline(np.asarray(sample, dtype=np.float64))
        return result
