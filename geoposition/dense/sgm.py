"""Semi-global matching of an epipolar pair, both ways, through OpenCV.

Disparity d of a pixel u of the first: its match is at u − d of the second. The second image is
matched with the first as well, each mirrored, and only disparities that agree count.

*Source*: Hirschmüller 2008, IEEE PAMI 30(2); OpenCV's variant sums over blocks the measure of
Birchfield and Tomasi 1998, IEEE PAMI 20(4), and takes three (of eight) paths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numba import njit, prange

from geoposition.dense.filters import Grey, Grey8, Mask, evened, without_speckles
from geoposition.errors import ArgumentError

_STEPS_PER_PX: Final = 16.0
_PENALTY_SMALL: Final = 8
_PENALTY_JUMP: Final = 32
_PREFILTER: Final = 63
_LEVELS: Final = 16
_MOST_DISPARITIES: Final = 1024


@dataclass(frozen=True, slots=True)
class SgmOptions:
    """How to match: block size (odd), agreement of both ways, smallest island kept.

    `paths` 3 is the fast way of OpenCV, 8 the full one (`MODE_HH`, a third of the speed).
    """

    block_px: int = 5
    agreement_px: float = 1.0
    island_px: int = 100
    paths: int = 3

    def __post_init__(self) -> None:
        if self.block_px % 2 != 1 or self.block_px < 1 or self.paths not in (3, 5, 8):
            raise ArgumentError("dense matching: an odd block size, and 3, 5 or 8 paths, expected")


@dataclass(frozen=True, slots=True, eq=False)
class Disparities:
    """Whole-range disparities of every pixel (rows, columns), and which of them to believe."""

    disparity_px: Grey
    believed: Mask


def match_rows(
    first: Grey, second: Grey, range_px: tuple[float, float], options: SgmOptions | None = None
) -> Disparities:
    """Match each row of `first` with that of `second`, both NaN where unknown.

    Disparities within `range_px`, least and most, are looked for.
    """
    options = options or SgmOptions()
    low = int(np.floor(range_px[0]))
    count = int(np.ceil((range_px[1] - low + 1) / _LEVELS)) * _LEVELS
    if not 0 < count <= _MOST_DISPARITIES:
        raise ArgumentError(
            f"dense matching: {count} disparities to look for, at most {_MOST_DISPARITIES} expected"
        )
    if min(first.shape) < 2 * options.block_px + 1 or first.shape[1] <= count + abs(low):
        nothing = np.full(first.shape, np.nan, dtype=np.float32)
        return Disparities(nothing, np.zeros(first.shape, dtype=np.bool_))
    left, left_valid = evened(first)
    right, right_valid = evened(second)
    matcher = _matcher(low, count, options)
    forth = _compute(matcher, left, right)
    # Mirrored, the second image is the left one, and disparities keep their sign.
    back = _compute(matcher, right[:, ::-1], left[:, ::-1])
    believed = np.empty(forth.shape, dtype=np.bool_)
    _agreeing(forth, back, left_valid, right_valid, float(low), options.agreement_px, believed)
    kept = without_speckles(
        np.where(believed, forth, np.float32(np.nan)), options.island_px, options.agreement_px
    )
    return Disparities(forth, np.isfinite(kept))


def _matcher(low: int, count: int, options: SgmOptions) -> Any:
    area = options.block_px**2
    modes = {
        3: cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        5: cv2.STEREO_SGBM_MODE_SGBM,
        8: cv2.STEREO_SGBM_MODE_HH,
    }
    return cv2.StereoSGBM_create(  # type: ignore[attr-defined]
        minDisparity=low,
        numDisparities=count,
        blockSize=options.block_px,
        P1=_PENALTY_SMALL * area,
        P2=_PENALTY_JUMP * area,
        disp12MaxDiff=-1,
        preFilterCap=_PREFILTER,
        uniquenessRatio=0,
        speckleWindowSize=0,
        speckleRange=0,
        mode=modes[options.paths],
    )


def _compute(matcher: Any, left: Grey8, right: Grey8) -> Grey:
    found = matcher.compute(np.ascontiguousarray(left), np.ascontiguousarray(right))
    disparity: Grey = found.astype(np.float32) / np.float32(_STEPS_PER_PX)
    return disparity


@njit(cache=True, parallel=True, error_model="numpy")
def _agreeing(
    forth: Grey,
    back: Grey,
    left_valid: Mask,
    right_valid: Mask,
    low: float,
    agreement_px: float,
    out: Mask,
) -> None:
    """Tell where the match of the match is the pixel itself. `back` is mirrored."""
    columns = forth.shape[1]
    for v in prange(forth.shape[0]):
        for u in range(columns):
            d = forth[v, u]
            at = math.floor(u - d + 0.5)
            out[v, u] = (
                left_valid[v, u]
                and d >= low
                and 0 <= at < columns
                and right_valid[v, at]
                and abs(d - back[v, columns - 1 - at]) <= agreement_px
            )
