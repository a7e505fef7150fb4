"""Compiled sines and cosines of angles that lie near each other, without calls in the loop."""

from __future__ import annotations

import math

from numba import njit

from geoposition.arrays import FloatArray

# NaN must keep its meaning, so only the reorderings of fast-math that respect it.
_FAST = {"contract", "arcp", "nsz", "reassoc"}
_NEAR_RAD = 0.1


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def fill_sines(angle_rad: FloatArray, n: int, sine: FloatArray, cosine: FloatArray) -> None:
    """Sines and cosines of the first `n` of `angle_rad`, into `sine` and `cosine`, to rounding.

    By series about the first angle that is a number (the first term left out is 2e-15 at 0.1
    rad), so that the loop compiles to vector instructions; angles further away one by one.
    """
    at = 0
    while at < n - 1 and math.isnan(angle_rad[at]):
        at += 1
    middle = angle_rad[at]
    sin_0, cos_0 = math.sin(middle), math.cos(middle)
    far = 0.0
    for i in range(n):
        d = angle_rad[i] - middle
        q = d * d
        s = d * (1.0 + q * (-1.0 / 6.0 + q * (1.0 / 120.0 + q * (-1.0 / 5040.0))))
        c = 1.0 + q * (-0.5 + q * (1.0 / 24.0 + q * (-1.0 / 720.0 + q / 40320.0)))
        sine[i] = sin_0 * c + cos_0 * s
        cosine[i] = cos_0 * c - sin_0 * s
        far += 1.0 if q > _NEAR_RAD * _NEAR_RAD else 0.0
    if far > 0.0:
        for i in range(n):
            if abs(angle_rad[i] - middle) > _NEAR_RAD:
                sine[i] = math.sin(angle_rad[i])
                cosine[i] = math.cos(angle_rad[i])
