"""Focal plane of the USGS CSM line scanner as directions of our cameras.

*Source.* usgscsm, `computeDistortedFocalPlaneCoordinates`, `removeDistortion` and
`createCameraLookVector`. Line and sample count from the image's corner there: a pixel's centre
lies at .5. The look vector is (z X, z Y, f), z being +1 or −1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from geoposition.arrays import FloatArray, read_only, require_finite
from geoposition.errors import ArgumentError
from geoposition.sensors.directions import CollinearDirections, Directions, PolynomialDirections


@dataclass(frozen=True, slots=True)
class FocalPlane:
    """Straight detector in the focal plane, before distortion: p(s) = `origin` + `step` × sample.

    Sample 0 is the first pixel's centre; lengths in the unit of the focal length. `look_sign`
    (2,) turns focal-plane axes into those of the camera frame.
    """

    origin: FloatArray
    step: FloatArray
    focal_length: float
    look_sign: tuple[float, float] = (1.0, 1.0)

    @classmethod
    def from_affine(
        cls,
        to_samples: ArrayLike,
        to_lines: ArrayLike,
        centre: tuple[float, float],
        start: tuple[float, float],
        sample_summing: float,
        focal_length: float,
    ) -> FocalPlane:
        """Focal plane of the transforms plane to detector samples and lines, each (3,).

        `centre` and `start` are the detector's (line, sample) origin and starting pixel.
        """
        samples, lines = np.asarray(to_samples, float), np.asarray(to_lines, float)
        matrix = np.array([samples[1:], lines[1:]])
        scale = np.linalg.norm(matrix[0]) * np.linalg.norm(matrix[1])
        if not abs(np.linalg.det(matrix)) > 1e-9 * scale:
            raise ArgumentError("focal plane: the transforms to samples and lines are parallel")
        if focal_length == 0 or sample_summing == 0:
            raise ArgumentError("focal plane: a focal length and a summing other than 0 expected")
        inverse = np.linalg.inv(matrix)
        offset = [
            0.5 * sample_summing + start[1] - centre[1] - samples[0],
            start[0] - centre[0] - lines[0],
        ]
        step = inverse @ np.array([sample_summing, 0.0])
        return cls(read_only(inverse @ np.array(offset)), read_only(step), focal_length)

    def linear(self) -> PolynomialDirections:
        """Directions without distortion."""
        sign = np.array(self.look_sign) / self.focal_length
        x, y = np.stack([self.origin, self.step], axis=-1) * sign[:, None]
        return PolynomialDirections(x, y)

    def radial(self, coefficients: ArrayLike) -> Directions:
        """Directions with the radial distortion p (1 − k0 − k1 r^2 − k2 r^4) removed."""
        k0, k1, k2 = np.asarray(coefficients, dtype=np.float64)
        if k0 == k1 == k2 == 0.0:
            return self.linear()
        if k0 >= 1.0:
            raise ArgumentError("radial distortion: a first coefficient below 1 expected")
        focal = self.focal_length / (1.0 - k0)
        size = abs(focal)
        sign = np.array(self.look_sign) * np.sign(focal)
        origin, step = self.origin * sign, self.step * sign
        return CollinearDirections(
            focal_length=size,
            detector_origin=(float(origin[0]), float(origin[1])),
            pitch=(float(step[0]), float(step[1])),
            radial=(float(k1 / (1 - k0) * size**2), float(k2 / (1 - k0) * size**4)),
        )

    def cubic_in_radius(self, coefficients: ArrayLike) -> Directions:
        """Directions with the distortion of the Kaguya cameras removed; see `CubicDirections`."""
        c = np.asarray(coefficients, dtype=np.float64)
        x = np.array([c[0] + c[1], *c[2:5]])
        y = np.array([c[5] + c[6], *c[7:10]])
        if not (np.any(x) or np.any(y)):
            return self.linear()
        return CubicDirections(self, x, y)


@dataclass(frozen=True, slots=True)
class CubicDirections:
    """Directions p + c(r), cubics of the distance r = |p| from the focal plane's origin.

    `x_cubic`, `y_cubic` (4,) ascending. *Source.* usgscsm's KAGUYALISM, in which the offset of
    the boresight adds to the constant terms; ASP fits it to ASTER and PeruSat as well.
    """

    plane: FocalPlane
    x_cubic: FloatArray
    y_cubic: FloatArray

    def __post_init__(self) -> None:
        for name in ("x_cubic", "y_cubic"):
            cubic = require_finite(read_only(getattr(self, name)), name)
            if cubic.shape != (4,):
                raise ArgumentError(f"distortion: {name}: 4 coefficients expected")
            object.__setattr__(self, name, cubic)

    @property
    def knots_sample(self) -> FloatArray:
        """The sample nearest to the origin, where r may have a kink."""
        p, step = self.plane.origin, self.plane.step
        return np.array([-np.dot(p, step) / np.dot(step, step)])

    @property
    def parameters(self) -> dict[str, float]:
        """Focal length and the eight coefficients `x0` ... `y3`."""
        named = {"focal_length": self.plane.focal_length}
        named |= {f"x{i}": float(c) for i, c in enumerate(self.x_cubic)}
        return named | {f"y{i}": float(c) for i, c in enumerate(self.y_cubic)}

    def with_parameters(self, values: dict[str, float]) -> Self:
        """Return the same with some parameters changed."""
        new = self.parameters | values
        if len(new) != len(self.parameters):
            raise ArgumentError(f"distortion: no parameter {set(values) - set(self.parameters)}")
        return replace(
            self,
            plane=replace(self.plane, focal_length=new["focal_length"]),
            x_cubic=np.array([new[f"x{i}"] for i in range(4)]),
            y_cubic=np.array([new[f"y{i}"] for i in range(4)]),
        )

    def tangents(self, sample: ArrayLike) -> FloatArray:
        """Tangents (..., 2) of `sample` (...)."""
        s = np.asarray(sample, dtype=np.float64)[..., None]
        p = self.plane.origin + s * self.plane.step
        r = np.linalg.norm(p, axis=-1)
        polyval = np.polynomial.polynomial.polyval
        shift = np.stack([polyval(r, self.x_cubic), polyval(r, self.y_cubic)], axis=-1)
        sign = np.array(self.plane.look_sign) / self.plane.focal_length
        result: FloatArray = (p + shift) * sign
        return result
