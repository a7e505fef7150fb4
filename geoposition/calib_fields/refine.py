"""Shifts of patches to a small part of a pixel: least-squares matching, with its covariance.

A patch of the reference, T, and the image brought to its geometry, S, differ by a shift p, gain
and offset:
    T(x) = a + b S(x + p) + noise.
Gauss-Newton with the slopes of T, which do not change while S is read anew at x + p: by cubic
splines, of one fraction for the whole patch, so that rows and columns are filtered one after the
other. The result solves sum(slope of T · residual) = 0. Because the slopes come from the other
image than the interpolated one, the noise that interpolation damps cannot draw p to whole pixels.

The covariance is N⁻¹ M N⁻¹ with M from the residuals summed over blocks of 8 × 8 pixels: residuals
of neighbouring pixels are correlated where the images differ by more than noise.

*Source*: Förstner 1982 and Gruen 1985 for the method, Baker & Matthews 2004 (IJCV 56) for the
slopes of the template, Unser 1999 (IEEE Signal Processing Magazine 16(6)) for splines, Liang &
Zeger 1986 for the covariance from clusters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import ndimage

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.calib_fields.refine_kernels import Grey, refine_patches

_SMOOTH_PX: Final = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """The reference, its slopes along rows and columns, and where it is known, as 0 or 1."""

    grey: Grey
    row_slope: Grey
    col_slope: Grey
    known: Grey

    @classmethod
    def of(cls, grey: FloatArray) -> Template:
        """Of an array (rows, cols), NaN where unknown."""
        filled, known = _filled(grey)
        spline = spline_coefficients(filled)
        smooth, slope = np.array([1.0, 4.0, 1.0]) / 6.0, np.array([-0.5, 0.0, 0.5])
        row_slope = ndimage.correlate1d(spline, slope, axis=0, mode="mirror")
        row_slope = ndimage.correlate1d(row_slope, smooth, axis=1, mode="mirror")
        col_slope = ndimage.correlate1d(spline, slope, axis=1, mode="mirror")
        col_slope = ndimage.correlate1d(col_slope, smooth, axis=0, mode="mirror")
        return cls(filled, row_slope, col_slope, known)


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """The image to be shifted: grey values, spline coefficients, and where it is known."""

    grey: Grey
    spline: Grey
    known: Grey

    @classmethod
    def of(cls, grey: FloatArray) -> Searched:
        """Of an array (rows, cols), NaN where unknown."""
        filled, known = _filled(grey)
        return cls(filled, spline_coefficients(filled), known)


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Shifts (n, 2) in (row, col), their covariance (n, 2, 2), correlation and convergence (n,).

    What lies at x in the template lies at x + shift in the searched image. `middle_px` (n, 2) is
    the mean place, from the patch's first pixel, of its pixels known in both.
    """

    middle_px: FloatArray
    shift_px: FloatArray
    covariance_px2: FloatArray
    correlation: FloatArray
    converged: BoolArray


def spline_coefficients(grey: Grey) -> Grey:
    """Coefficients of the cubic B-spline through `grey` (rows, cols), mirrored at its ends."""
    out: Grey = ndimage.spline_filter(grey, 3, output=np.float64, mode="mirror").astype(np.float32)
    return out


def _filled(grey: FloatArray) -> tuple[Grey, Grey]:
    """Smoothed values less their mean, holes filled with it; and 0 or 1 for known.

    The detail that smoothing removes is what cubic splines cannot move without shifting it.
    """
    known = np.isfinite(grey)
    middle = float(grey[known].mean()) if known.any() else 0.0
    filled = np.where(known, grey - middle, 0.0).astype(np.float32)
    filled = ndimage.gaussian_filter(filled, _SMOOTH_PX, mode="nearest", truncate=4.0)
    if not known.all():
        known = ndimage.minimum_filter(known, 5, mode="nearest")
    return filled, known.astype(np.float32)


def refine(
    template: Template,
    searched: Searched,
    corners: IntArray,
    start_px: FloatArray,
    size: int = 64,
    farthest_px: float = 1.5,
) -> Refined:
    """Refine the shifts of patches whose first pixels are `corners` (n, 2), from `start_px` (n, 2).

    `size` is the patches' side. A patch has not converged if it leaves its start by more than
    `farthest_px`, or the searched image.
    """
    n = len(corners)
    shift = np.array(start_px, dtype=np.float64).reshape(n, 2)
    covariance = np.full((n, 2, 2), np.nan)
    correlation, converged = np.full(n, np.nan), np.zeros(n, dtype=np.bool_)
    middle = np.full((n, 2), 0.5 * (size - 1))
    refine_patches(
        template.grey,
        template.row_slope,
        template.col_slope,
        template.known,
        searched.spline,
        searched.known,
        np.ascontiguousarray(corners, dtype=np.int64),
        size,
        farthest_px,
        middle,
        shift,
        covariance,
        correlation,
        converged,
    )
    return Refined(middle, shift, covariance, correlation, converged)
