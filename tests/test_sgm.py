"""Matching of rows and its refinement: known disparities, holes, occlusions, stated errors."""

from __future__ import annotations

import numpy as np
import pytest
from dense_scenes import texture
from scipy.ndimage import map_coordinates

from geoposition.dense.filters import evened, without_speckles
from geoposition.dense.refine import refine_rows
from geoposition.dense.sgm import SgmOptions, match_rows
from geoposition.errors import ArgumentError

SIZE = 320


def seen_with(disparity: np.ndarray, noise: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """A pair whose first image has `disparity` at every pixel of the second one's grid."""
    rng = np.random.default_rng(4)
    second = texture(SIZE)
    v, u = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    first = map_coordinates(second, [v, u - disparity], order=3, mode="mirror")
    pair = (first + rng.normal(0, noise, first.shape), second + rng.normal(0, noise, first.shape))
    return pair[0].astype(np.float32), pair[1].astype(np.float32)


def matched(
    first: np.ndarray, second: np.ndarray, span: tuple[float, float], **options: int
) -> tuple[np.ndarray, np.ndarray]:
    found = match_rows(first, second, span, SgmOptions(**options))
    return refine_rows(first, second, found.disparity_px, found.believed)


@pytest.mark.parametrize("shift", [-7.0, 0.25, 0.5, 11.37])
@pytest.mark.parametrize("paths", [3, 8])
def test_a_constant_disparity_is_found_without_pixel_locking(shift: float, paths: int) -> None:
    first, second = seen_with(np.full((SIZE, SIZE), shift))
    disparity, sigma = matched(first, second, (-16.0, 20.0), paths=paths)
    inner = np.s_[30:-30, 40:-40]
    assert np.isfinite(disparity[inner]).mean() > 0.98
    off = disparity[inner] - shift
    assert abs(np.nanmedian(off)) < 0.01
    assert 1.4826 * np.nanmedian(np.abs(off)) < 0.04
    assert np.nanmedian(sigma[inner]) < 0.06


def test_refinement_takes_the_bias_of_sub_pixels_out() -> None:
    """Over a slow ramp the rough disparities heap up at whole pixels; the refined ones do not."""
    v, u = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    truth = 3.0 + u / 80.0 + 0.0 * v
    first, second = seen_with(truth)
    found = match_rows(first, second, (-4.0, 12.0))
    disparity, _ = refine_rows(first, second, found.disparity_px, found.believed)
    inner = np.s_[30:-30, 40:-40]

    def locking(d: np.ndarray) -> float:
        """How errors follow the fraction of a pixel: amplitude of their first harmonic."""
        error, phase = (d - truth)[inner], 2.0 * np.pi * truth[inner]
        good = np.isfinite(error) & (np.abs(error) < 0.5)
        return float(
            np.hypot(
                np.mean(error[good] * np.sin(phase[good])),
                np.mean(error[good] * np.cos(phase[good])),
            )
        )

    assert locking(disparity) < 0.01
    assert locking(disparity) < 0.5 * locking(found.disparity_px)


def test_stated_sigmas_are_what_errors_have() -> None:
    v, u = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    truth = 2.0 + np.sin(v / 40.0) + np.cos(u / 50.0)
    for noise in (3.0, 12.0):
        disparity, sigma = matched(*seen_with(truth, noise), (-8.0, 12.0))
        ratio = ((disparity - truth) / sigma)[30:-30, 40:-40]
        ratio = ratio[np.isfinite(ratio)]
        assert 0.6 < 1.4826 * np.median(np.abs(ratio)) < 1.6, noise


def test_what_only_one_image_shows_is_left_out() -> None:
    """A block 12 px nearer hides a strip 12 columns wide: no disparity is made up for it."""
    truth = np.full((SIZE, SIZE), 2.0)
    truth[100:200, 120:220] = 14.0
    first, second = seen_with(truth)
    disparity, _ = matched(first, second, (-4.0, 24.0))
    good = np.isfinite(disparity)
    assert np.mean(np.abs(disparity - truth)[good] > 1.0) < 0.03
    inner = np.s_[110:190, 130:210]
    assert good[inner].mean() > 0.95
    assert np.nanmedian(np.abs(disparity[inner] - 14.0)) < 0.1


def test_noise_matches_nothing() -> None:
    rng = np.random.default_rng(0)
    a, b = (rng.normal(500, 40, (SIZE, SIZE)).astype(np.float32) for _ in range(2))
    disparity, _ = matched(a, b, (-8.0, 24.0))
    assert np.isfinite(disparity).mean() < 0.02


def test_no_data_has_no_disparity() -> None:
    first, second = seen_with(np.full((SIZE, SIZE), 3.0))
    first[50:90, 60:120] = np.nan
    second[150:200, 100:160] = np.nan
    disparity, _ = matched(first, second, (-8.0, 12.0))
    assert not np.isfinite(disparity[50:90, 60:120]).any()
    assert not np.isfinite(disparity[150:200, 105:160]).any()
    assert np.isfinite(disparity[220:300, 60:260]).mean() > 0.95
    empty = np.full_like(first, np.nan)
    assert not np.isfinite(matched(empty, second, (-8.0, 12.0))[0]).any()


def test_even_contrast_does_not_depend_on_what_else_is_shown() -> None:
    """Two windows that share ground show it alike, though one holds a bright field besides."""
    grey = texture(SIZE).astype(np.float32)
    grey[:, 250:] = 4000.0
    small, _ = evened(grey[:, :200], 5.0)
    large, _ = evened(grey, 5.0)
    assert np.max(np.abs(small[:, :180].astype(int) - large[:, :180])) <= 1
    assert small.std() > 20.0


def test_islands_go() -> None:
    disparity = np.full((60, 60), 5.0, dtype=np.float32)
    disparity[20:24, 20:24] = 9.0
    kept = without_speckles(disparity, 50, 1.0)
    assert np.isnan(kept[20:24, 20:24]).all()
    assert np.isfinite(kept).sum() == 3600 - 16


def test_bad_options_are_refused() -> None:
    with pytest.raises(ArgumentError, match="odd"):
        SgmOptions(block_px=4)
    nothing = np.zeros((100, 100), dtype=np.float32)
    with pytest.raises(ArgumentError, match="disparities"):
        match_rows(nothing, nothing, (0.0, 5000.0))
