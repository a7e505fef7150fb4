"""Smooth errors of an image: polynomials in line and sample, found in spite of blunders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import BoolArray, FloatArray

_TUKEY: Final = 4.685
_NMAD: Final = 1.4826022185056018
_TURNS: Final = 15
_POINTS_PER_TERM: Final = 6


@dataclass(frozen=True, slots=True, eq=False)
class ImageCorrection:
    """Polynomial of (line, sample), normalised by `centre` (2,) and `half` (2,), to two numbers.

    `coefficients` (terms, 2) in the order of `powers` (terms, 2).
    """

    centre: FloatArray
    half: FloatArray
    powers: FloatArray
    coefficients: FloatArray

    @classmethod
    def none(cls) -> ImageCorrection:
        """No correction."""
        zero, one = np.zeros(2), np.ones(2)
        return cls(zero, one, np.zeros((1, 2)), np.zeros((1, 2)))

    def at(self, image_px: FloatArray) -> FloatArray:
        """Correction (..., 2) at `image_px` (..., 2)."""
        result: FloatArray = (
            polynomial_terms((image_px - self.centre) / self.half, self.powers) @ self.coefficients
        )
        return result


def polynomial_powers(degree: int) -> FloatArray:
    """Exponents (terms, 2) of all monomials of two variables up to `degree`."""
    pairs = [(i, n - i) for n in range(degree + 1) for i in range(n, -1, -1)]
    return np.array(pairs, dtype=np.float64)


def polynomial_terms(place: FloatArray, powers: FloatArray) -> FloatArray:
    """Monomials (..., terms) of `place` (..., 2)."""
    columns = [
        place[..., 0] ** int(i) * place[..., 1] ** int(j) for i, j in powers
    ]  # small whole powers
    return np.stack(columns, axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class SmoothFit:
    """A robust fit: its polynomial, which points agree (n,), and their spread `scale_px` (2,)."""

    correction: ImageCorrection
    good: BoolArray
    scale_px: FloatArray


def robust_polynomial(
    image_px: FloatArray,
    error_px: FloatArray,
    degree: int,
    *,
    limit: float = 4.5,
    least_scale_px: float = 0.05,
) -> SmoothFit:
    """Fit `error_px` (n, 2) at `image_px` (n, 2); up to almost half may be anywhere.

    From the densest place of the errors on, the degree grows one by one, by least squares
    reweighted with Tukey's function. A point is good within `limit` robust standard deviations
    in both coordinates. The degree stops at what the number of points carries.
    """
    low, high = image_px.min(axis=0), image_px.max(axis=0)
    centre, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1.0)
    place = (image_px - centre) / half
    middle = densest(error_px)
    left = error_px - middle
    size = np.max(np.abs(left), axis=1)
    # the nearer half of the points sets the first scale
    scale = np.full(2, max(_NMAD * float(np.median(size)), least_scale_px))
    fitted = np.broadcast_to(middle, error_px.shape)
    powers, coefficients = np.zeros((1, 2)), middle[None]
    for now in range(degree + 1):
        now_powers = polynomial_powers(now)
        if now and len(error_px) < _POINTS_PER_TERM * len(now_powers):
            break
        powers, terms = now_powers, polynomial_terms(place, now_powers)
        for _ in range(_TURNS):
            u = (error_px - fitted) / (_TUKEY * scale)
            weight = np.prod(np.where(np.abs(u) < 1.0, (1.0 - u * u) ** 2, 0.0), axis=1)
            if weight.sum() < len(powers) + 2:
                break
            root = np.sqrt(weight)[:, None]
            coefficients = np.linalg.lstsq(root * terms, root * error_px, rcond=None)[0]
            before, fitted = fitted, terms @ coefficients
            close = weight > 0.0
            new = _NMAD * np.median(np.abs(error_px - fitted)[close], axis=0)
            scale = np.maximum(new, least_scale_px)
            if np.max(np.abs(fitted - before)) < 1e-3 * float(scale.min()):
                break
    good = np.all(np.abs(error_px - fitted) <= limit * scale, axis=1)
    return SmoothFit(ImageCorrection(centre, half, powers, coefficients), good, scale)


def densest(points: FloatArray) -> FloatArray:
    """Return the middle (2,) of the densest part of `points` (n, 2)."""
    if len(points) < 4:
        middle: FloatArray = np.median(points, axis=0)
        return middle
    pick = points[np.linspace(0, len(points) - 1, min(len(points), 1500)).astype(np.int64)]
    distance = np.max(np.abs(pick[:, None] - pick[None]), axis=-1)
    # the point with the nearest quarter of the others closest to it
    near = np.partition(distance, len(pick) // 4, axis=1)[:, len(pick) // 4]
    at = pick[int(np.argmin(near))]
    within = points[np.max(np.abs(points - at), axis=1) <= near.min()]
    result: FloatArray = np.median(within, axis=0)
    return result
