"""RANSAC of a rotation against a low-order polynomial in sliding windows.

In a window the rotation vectors from a reference sample follow a polynomial of time. Each draw
takes just enough samples to fix one; the draw with the smallest median residual wins (least
median of squares: half of the window may be wrong and no threshold has to be guessed), and the
samples that agree with it fit the final polynomial.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, IntArray
from geoposition.sensors.attitude_determination.checks.ransac_kernels import fit_all


@dataclass(frozen=True, slots=True, eq=False)
class WindowFits:
    """Polynomials of the windows `start` (w,), each over `length` samples of a series.

    `coefficients` (w, degree + 1, 3) give the rotation vector (rad, axes weighted away again)
    from `reference` (w, 4) at u = (t − `middle_s`) / `half_s`. `scale` (w,) is the noise of one
    axis in weighted units, `residual` (w, length) the weighted lengths of what is left.
    """

    start: IntArray
    length: int
    reference: FloatArray
    middle_s: FloatArray
    half_s: FloatArray
    coefficients: FloatArray
    scale: FloatArray
    residual: FloatArray

    def rotations(self, window: IntArray, times_s: FloatArray) -> Rotation:
        """Model attitude (n,) of one window each, at `times_s` (n,)."""
        u = (times_s - self.middle_s[window]) / self.half_s[window]
        powers = u[:, None] ** np.arange(self.coefficients.shape[1])
        vectors = np.einsum("nd,ndk->nk", powers, self.coefficients[window])
        return Rotation.from_quat(self.reference[window]) * Rotation.from_rotvec(vectors)


def window_starts(n: int, length: int) -> IntArray:
    """First samples of windows over `n` samples that overlap by three quarters."""
    if n <= length:
        return np.zeros(1, dtype=np.int64)
    step = max(1, length // 4)
    return np.unique(np.append(np.arange(0, n - length, step), n - length)).astype(np.int64)


def fit_windows(
    times_s: FloatArray,
    quat_xyzw: FloatArray,
    weights: FloatArray,
    length: int,
    *,
    degree: int = 2,
    threshold_sigma: float = 5.0,
    draws: int = 50,
    seed: int = 1,
) -> WindowFits:
    """Fit all windows of `length` samples of one head's unit quaternions (n, 4).

    `weights` (3,) are 1 / noise about the sensor's axes (their ratio matters). The draws depend
    on `seed` and the window alone. `length` is cut to the series'. *Source*: T 2.3.3; Rousseeuw &
    Leroy 1987, Robust Regression, 5.1.
    """
    length = min(length, len(times_s))
    start = window_starts(len(times_s), length)
    degree = max(0, min(degree, length - 2))
    w = len(start)
    reference = np.empty((w, 4))
    span = np.empty((w, 2))
    coefficients = np.empty((w, degree + 1, 3))
    scale = np.empty(w)
    residual = np.empty((w, length))
    fit_all(
        np.ascontiguousarray(times_s),
        np.ascontiguousarray(quat_xyzw),
        np.ascontiguousarray(weights),
        start,
        threshold_sigma,
        draws,
        seed,
        reference,
        span,
        coefficients,
        scale,
        residual,
    )
    return WindowFits(
        start, length, reference, span[:, 0], span[:, 1], coefficients, scale, residual
    )
