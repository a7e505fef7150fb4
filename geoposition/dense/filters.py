"""Local means of images with holes, and what is made of them: OpenCV's separable filters."""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import cv2
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Grey: TypeAlias = NDArray[np.float32]
Grey8: TypeAlias = NDArray[np.uint8]
Mask: TypeAlias = NDArray[np.bool_]

_REACH_PX: Final = 31
_MIDDLE: Final = 128.0
_CONTRAST: Final = 42.0
_SPARSE: Final = 4
_FLOOR: Final = 0.08
"""Local contrast below this part of the whole window's counts as noise and is not raised."""


def local_mean(grey: Grey, size: int) -> Grey:
    """Mean over size × size pixels."""
    mean = cv2.boxFilter(grey, cv2.CV_32F, (size, size), borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(mean, dtype=np.float32)


def gaussian_mean(grey: Grey, sigma_px: float, size: int) -> Grey:
    """Mean with Gaussian weights over size × size pixels."""
    mean = cv2.GaussianBlur(grey, (size, size), sigma_px, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(mean, dtype=np.float32)


def evened(grey: Grey, noise: float | None = None) -> tuple[Grey8, Mask]:
    """Grey values as 8 bits of equal local mean and contrast, and which of them are valid.

    The same ground looks the same in every window that shows it, whatever else the window
    shows: neighbouring tiles agree. NaN become the middle grey. `noise` is the contrast below
    which nothing is raised; part of the whole window's unless given.
    """
    valid = np.isfinite(grey)
    if not valid.any():
        return np.full(grey.shape, _MIDDLE, dtype=np.uint8), valid
    middle = np.float32(np.nanmean(grey[::_SPARSE, ::_SPARSE]))
    if not np.isfinite(middle):
        middle = np.float32(np.nanmean(grey))
    whole = bool(valid.all())
    centred = grey - middle if whole else np.where(valid, grey - middle, np.float32(0.0))
    share = np.ones((1, 1), dtype=np.float32)
    if not whole:
        share = np.maximum(local_mean(valid.astype(np.float32), _REACH_PX), np.float32(1e-3))
    mean = local_mean(centred, _REACH_PX) / share
    square = local_mean(centred * centred, _REACH_PX) / share
    few = np.s_[::_SPARSE, ::_SPARSE]
    usual = np.sqrt(np.maximum(square[few] - mean[few] ** 2, 0.0))[valid[few]]
    floor = noise if noise is not None else _FLOOR * float(np.median(usual)) if usual.size else 0.0
    out = np.empty(grey.shape, dtype=np.uint8)
    _even(centred, mean, square, valid, float(floor), out)
    return out, valid


@njit(cache=True, parallel=True, error_model="numpy")
def _even(centred: Grey, mean: Grey, square: Grey, valid: Mask, floor: float, out: Grey8) -> None:
    for i in prange(out.shape[0]):
        for j in range(out.shape[1]):
            level = _MIDDLE
            if valid[i, j]:
                contrast = math.sqrt(max(square[i, j] - mean[i, j] * mean[i, j], 0.0)) + floor
                level += (centred[i, j] - mean[i, j]) * (_CONTRAST / max(contrast, 1e-6))
            out[i, j] = np.uint8(min(max(math.floor(level + 0.5), 0.0), 255.0))


def smoothed(disparity: Grey, jump_px: float) -> Grey:
    """Smooth disparities without blurring jumps of `jump_px`; no NaN allowed."""
    median = cv2.medianBlur(disparity, 5)
    return np.asarray(cv2.bilateralFilter(median, 5, jump_px, 1.5), dtype=np.float32)


def without_speckles(disparity: Grey, area_px: int, jump_px: float) -> Grey:
    """Return `disparity` with NaN for islands of fewer than `area_px` that differ by a jump."""
    known = np.isfinite(disparity)
    if not known.any():
        return disparity
    scale = 16.0
    low = float(disparity[known].min())
    levels = np.where(known, (disparity - low) * scale + 1.0, 0.0)
    whole = np.minimum(np.rint(levels), 32000.0).astype(np.int16)
    cv2.filterSpeckles(whole, 0, area_px, int(jump_px * scale))
    return np.where(whole > 0, disparity, np.float32(np.nan)).astype(np.float32)
