# mypy: disable-error-code="import-not-found,import-untyped"
"""Sub-pixel matching of patches beside OpenCV's: same patches, a shift that is known exactly.

Textures are moved by Fourier's theorem; both images get noise. What each is off from the true
shift, root mean square, stands beside its speed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from geoposition.arrays import FloatArray, IntArray
from geoposition.calib_fields.refine import Searched, Template, refine
from geoposition.calib_fields.synthetic_dom import synthetic_dom
from geoposition.reimage.ortho import OrthoGrid
from geoposition.scripts.bench.machine import installed
from geoposition.scripts.bench.measure import Case, Contender, Missing

TARGET_MPOINT_S: Final = 0.005
"""5,000 points a second."""
_SIDE: Final = 768
_WINDOW: Final = 64
_POINTS: Final = 4000
_PEER_POINTS: Final = 400
_NOISES: Final = (0.0, 4.0)
_SAME_PX: Final = 1.0


def dom_match_cases(quick: bool = False) -> list[Case]:
    """Return matching of 64 × 64 patches without noise and with noise of 4 grey values."""
    return [_case(noise, quick) for noise in _NOISES]


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


def _case(noise: float, quick: bool) -> Case:
    first, second, shift = pair(noise, 1)
    points, fewer = (60, 20) if quick else (_POINTS, _PEER_POINTS)
    corners = np.random.default_rng(0).integers(40, _SIDE - _WINDOW - 40, (points, 2))
    template, searched = Template.of(first), Searched.of(second)
    start = np.zeros((points, 2))

    def ours() -> FloatArray:
        return refine(template, searched, corners, start, _WINDOW).shift_px

    def off(found: FloatArray) -> str:
        return f"off by {np.sqrt(np.nanmean((found - shift) ** 2)):.4f} px rms"

    def contender(name: str, run: Callable[[], FloatArray], rows: slice) -> Contender:
        return Contender(name, rows, run, _as_found, off(run()))

    some = slice(0, fewer)
    peers: list[Contender | Missing] = [
        _arosics(),
        contender("OpenCV ECC, one thread", lambda: ecc(first, second, corners[some]), some),
        contender(
            "OpenCV phaseCorrelate", lambda: phase_correlate(first, second, corners[some]), some
        ),
    ]
    return Case(
        key=f"dom-match-{noise:g}",
        title=f"sub-pixel matching, {_WINDOW} px, noise of {noise:g} grey values",
        points=points,
        unit="px",
        tolerance=_SAME_PX,
        ours=contender("geoposition", ours, slice(None)),
        peers=peers,
        target_mpoint_s=None if quick else TARGET_MPOINT_S,
    )


def _as_found(found: Any) -> FloatArray:
    result: FloatArray = found
    return result


def _arosics() -> Missing:
    version = installed("arosics")
    if version is not None:
        return Missing(f"arosics {version}", "takes georeferenced rasters, not patches")
    return Missing(
        "arosics", "not installed: pip builds GDAL's own bindings for it, on GDAL >= 3.8 headers"
    )


def ecc(first: FloatArray, second: FloatArray, corners: IntArray) -> FloatArray:
    """Shifts (n, 2) by OpenCV's enhanced correlation coefficient, a translation."""
    import cv2

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 1e-5)
    out = np.full((len(corners), 2), np.nan)
    everywhere = np.full((_WINDOW, _WINDOW), 255, dtype=np.uint8)
    for n, (a, b) in enumerate(_patches(first, second, corners, np.float32)):
        warp = np.eye(2, 3, dtype=np.float32)
        try:
            _, found = cv2.findTransformECC(a, b, warp, cv2.MOTION_TRANSLATION, stop, everywhere, 1)
        except cv2.error:
            continue
        out[n] = found[1, 2], found[0, 2]
    cv2.setNumThreads(threads)
    return out


def phase_correlate(first: FloatArray, second: FloatArray, corners: IntArray) -> FloatArray:
    """Shifts (n, 2) by OpenCV's phase correlation under a Hann window."""
    import cv2

    window = cv2.createHanningWindow((_WINDOW, _WINDOW), cv2.CV_64F)
    out = np.empty((len(corners), 2))
    for n, (a, b) in enumerate(_patches(first, second, corners, np.float64)):
        # copies: some releases window their inputs in place
        (x, y), _ = cv2.phaseCorrelate(a.copy(), b.copy(), window)
        out[n] = y, x
    return out


def _patches(
    first: FloatArray, second: FloatArray, corners: IntArray, kind: Any
) -> list[tuple[Any, Any]]:
    parts = [np.s_[row : row + _WINDOW, col : col + _WINDOW] for row, col in corners]
    return [
        (np.ascontiguousarray(first[p], dtype=kind), np.ascontiguousarray(second[p], dtype=kind))
        for p in parts
    ]
