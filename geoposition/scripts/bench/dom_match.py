"""Precision and speed of the sub-pixel matching beside OpenCV's ECC.

Textures are moved by Fourier's theorem, so that the shift is known exactly; both images get noise.
Run `python -m geoposition.scripts.bench.dom_match`.
"""

from __future__ import annotations

from time import perf_counter
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray, IntArray
from geoposition.calib_fields.refine import Searched, Template, refine
from geoposition.calib_fields.synthetic_dom import synthetic_dom
from geoposition.reimage.ortho import OrthoGrid

_SIDE: Final = 768
_WINDOW: Final = 64
_POINTS: Final = 4000
_REPEATS: Final = 5


def pair(noise: float, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Texture, the same moved and of other contrast, and by how much."""
    rng = np.random.default_rng(seed)
    grey = synthetic_dom(OrthoGrid("EPSG:32633", 0.0, 0.0, 1.0, (_SIDE, _SIDE)), seed).grey
    shift = rng.uniform(-0.5, 0.5, 2)
    k = np.fft.fftfreq(_SIDE)
    turn = np.exp(-2j * np.pi * (k[:, None] * shift[0] + k[None] * shift[1]))
    moved = np.fft.ifft2(np.fft.fft2(grey) * turn).real
    first, second = (g + noise * rng.standard_normal(g.shape) for g in (grey, 1.3 * moved - 9.0))
    return first, second, shift


def ours(first: FloatArray, second: FloatArray, corners: IntArray) -> tuple[FloatArray, float]:
    """Shifts (n, 2) and points per second, the best of several runs."""
    template, searched = Template.of(first), Searched.of(second)
    start = np.zeros((len(corners), 2))
    found, best = refine(template, searched, corners, start, _WINDOW), np.inf
    for _ in range(_REPEATS):
        begin = perf_counter()
        found = refine(template, searched, corners, start, _WINDOW)
        best = min(best, perf_counter() - begin)
    return found.shift_px, len(corners) / best


def ecc(first: FloatArray, second: FloatArray, corners: IntArray) -> tuple[FloatArray, float]:
    """OpenCV's enhanced correlation coefficient, a translation, one core."""
    import cv2

    cv2.setNumThreads(1)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 1e-5)
    out = np.full((len(corners), 2), np.nan)
    a, b = first.astype(np.float32), second.astype(np.float32)
    begin = perf_counter()
    for n, (row, col) in enumerate(corners):
        part = np.s_[row : row + _WINDOW, col : col + _WINDOW]
        warp = np.eye(2, 3, dtype=np.float32)
        try:
            _, found = cv2.findTransformECC(
                np.ascontiguousarray(a[part]),
                np.ascontiguousarray(b[part]),
                warp,
                cv2.MOTION_TRANSLATION,
                stop,
                np.full((_WINDOW, _WINDOW), 255, dtype=np.uint8),
                1,
            )
        except cv2.error:
            continue
        out[n] = found[1, 2], found[0, 2]
    return out, len(corners) / (perf_counter() - begin)


def main() -> None:
    """Print a table: noise, root mean square error along rows and columns, points per second."""
    rng = np.random.default_rng(0)
    corners = rng.integers(40, _SIDE - _WINDOW - 40, (_POINTS, 2))
    print(f"{'':12}{'noise':>7}{'rms row':>10}{'rms col':>10}{'points/s':>10}")
    for noise in (0.0, 4.0):
        first, second, shift = pair(noise, 1)
        for name, method, some in (("geoposition", ours, corners), ("ECC", ecc, corners[:500])):
            try:
                found, speed = method(first, second, some)
            except ImportError:
                continue
            rms = np.sqrt(np.nanmean((found - shift) ** 2, axis=0))
            print(f"{name:12}{noise:7.1f}{rms[0]:10.4f}{rms[1]:10.4f}{speed:10.0f}")


if __name__ == "__main__":
    main()
