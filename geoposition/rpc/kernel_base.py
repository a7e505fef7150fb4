"""What the RPC kernels share: the parameters of a model, the cubic and its gradient, flags.

The twenty terms of a cubic are in RPC00B order, 1, L, P, H, LP, LH, PH, L², P², H², LPH, L³,
LP², LH², L²P, P³, PH², L²H, P²H, H³, with L, P, H the normalised longitude, latitude and height.

*Source*: STDI-0002 vol. 1 appendix E (RPC00B), section E.2.4.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from geoposition.arrays import FloatArray
from geoposition.flags import Flag

LINE_NUM, LINE_DEN, SAMP_NUM, SAMP_DEN, START_LON, START_LAT = 0, 20, 40, 60, 80, 100
"""Where each polynomial begins in the coefficient vector (120)."""

# Reordering and contraction are safe; NaN and infinity must keep their meaning here.
FAST = {"contract", "arcp", "reassoc", "nsz"}
# `forceinline` compiles each function once and still lets the loops around it vectorise.
INLINE: dict[str, Any] = {"forceinline": True, "fastmath": FAST, "error_model": "numpy"}
PARALLEL: dict[str, Any] = {
    "cache": True, "parallel": True, "fastmath": FAST, "error_model": "numpy"
}  # fmt: skip

BLOCK = 128
"""Points worked on together, in columns that fit the first-level cache."""
TASK = BLOCK * 64
"""Points given to a thread at a time."""

TWO_PI = 2.0 * math.pi
_MIN_DENOMINATOR = 1e-3
"""A denominator below this share of its value in mid-image has lost its meaning."""

# Flags as floats, so that the loops stay in one vector width.
OUTSIDE_IMAGE = float(Flag.OUTSIDE_IMAGE)
OUTSIDE_MODEL = float(Flag.OUTSIDE_MODEL)
BAD_INPUT = float(Flag.BAD_INPUT)
NOT_CONVERGED = float(Flag.NOT_CONVERGED)
HAS_NUMBERS = float(Flag.OUTSIDE_IMAGE) + 0.5

# Unsigned indices spare the test for negative ones.
U1, U2, U3 = np.uint64(1), np.uint64(2), np.uint64(3)


class KernelParameters(NamedTuple):
    """Scalars of one model: `*_off` and `*_unit` normalise ground, `*_scale` unpacks the image.

    The pixel bounds are infinite where the image size is unknown. `*_den_unit` is one over the
    denominator in mid-image; `*_centre` and `*_half` bound the normalised ground on which the
    polynomials are trusted; `start_*` normalise the variables of the start polynomials.
    """

    lon_off_rad: float
    lon_unit: float
    lat_off_rad: float
    lat_unit: float
    height_off_m: float
    height_unit: float
    line_off_px: float
    line_scale_px: float
    samp_off_px: float
    samp_scale_px: float
    line_low_px: float
    line_high_px: float
    samp_low_px: float
    samp_high_px: float
    line_den_unit: float
    samp_den_unit: float
    lon_centre: float
    lon_half: float
    lat_centre: float
    lat_half: float
    height_centre: float
    height_half: float
    start_line_off: float
    start_line_unit: float
    start_samp_off: float
    start_samp_unit: float
    start_height_off: float
    start_height_unit: float


@njit(**INLINE)
def cubic(c: FloatArray, k: int, L: float, P: float, H: float) -> float:
    """Cubic polynomial whose twenty coefficients begin at `c[k]`."""
    value: float = (
        c[k]
        + L * (c[k + 1] + P * (c[k + 4] + H * c[k + 10] + L * c[k + 14] + P * c[k + 12]))
        + L * (H * (c[k + 5] + L * c[k + 17] + H * c[k + 13]) + L * (c[k + 7] + L * c[k + 11]))
        + P * (c[k + 2] + H * (c[k + 6] + P * c[k + 18] + H * c[k + 16]))
        + P * (P * (c[k + 8] + P * c[k + 15]))
        + H * (c[k + 3] + H * (c[k + 9] + H * c[k + 19]))
    )
    return value


@njit(**INLINE)
def cubic_gradient(
    c: FloatArray, k: int, L: float, P: float, H: float
) -> tuple[float, float, float]:
    """Partial derivatives of `cubic` with respect to L, P and H."""
    d_lon = (
        c[k + 1]
        + P * (c[k + 4] + P * c[k + 12])
        + H * (c[k + 5] + H * c[k + 13] + P * c[k + 10])
        + L * (2.0 * (c[k + 7] + P * c[k + 14] + H * c[k + 17]) + 3.0 * L * c[k + 11])
    )
    d_lat = (
        c[k + 2]
        + L * (c[k + 4] + L * c[k + 14])
        + H * (c[k + 6] + H * c[k + 16] + L * c[k + 10])
        + P * (2.0 * (c[k + 8] + L * c[k + 12] + H * c[k + 18]) + 3.0 * P * c[k + 15])
    )
    d_height = (
        c[k + 3]
        + L * (c[k + 5] + L * c[k + 17] + P * c[k + 10])
        + P * (c[k + 6] + P * c[k + 18])
        + H * (2.0 * (c[k + 9] + L * c[k + 13] + P * c[k + 16]) + 3.0 * H * c[k + 19])
    )
    return d_lon, d_lat, d_height


@njit(**INLINE)
def wrapped(angle_rad: float) -> float:
    """Bring an angle into ±π."""
    wrapped_rad: float = angle_rad - TWO_PI * np.rint(angle_rad * (1.0 / TWO_PI))
    return wrapped_rad


@njit(**INLINE)
def outside_model(
    p: KernelParameters, L: float, P: float, H: float, line_den: float, samp_den: float
) -> bool:
    """Whether the ground is beyond the trusted domain or a denominator is no longer sound."""
    return (
        (line_den * p.line_den_unit < _MIN_DENOMINATOR)
        | (samp_den * p.samp_den_unit < _MIN_DENOMINATOR)
        | (abs(L - p.lon_centre) > p.lon_half)
        | (abs(P - p.lat_centre) > p.lat_half)
        | (abs(H - p.height_centre) > p.height_half)
    )


@njit(**INLINE)
def outside_image(p: KernelParameters, line_px: float, samp_px: float) -> bool:
    """Whether the image point is outside the pixels of a known image."""
    return (
        (line_px < p.line_low_px)
        | (line_px > p.line_high_px)
        | (samp_px < p.samp_low_px)
        | (samp_px > p.samp_high_px)
    )
