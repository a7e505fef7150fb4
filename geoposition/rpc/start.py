"""What is worked out once per RPC: a good first guess of the ground, and where to trust it.

The inverse of an RPC is nearly affine. A cubic polynomial in line, sample and height, fitted to
the model's own inverse on a grid, starts Newton's method within a small part of a pixel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geoposition.arrays import FloatArray

HEIGHT_MARGIN_M = 20e3
"""Heights that far beyond the model's range are still answered (every place on Earth is)."""

_NODES = 6
_MAX_ITERATIONS = 30
_MAX_DOMAIN = 1e3


class StartTable(NamedTuple):
    """Start polynomials (20 each) with their normalisation, and the trusted normalised ground.

    Each `*_off` and `*_half` is a centre and a half-width: of normalised line, sample and
    height for the polynomials' variables, of normalised longitude and latitude for the domain.
    """

    lon: FloatArray
    lat: FloatArray
    line_off: float
    line_half: float
    samp_off: float
    samp_half: float
    line_den: float
    samp_den: float
    lon_off: float
    lon_half: float
    lat_off: float
    lat_half: float


def cubic_terms(L: FloatArray, P: FloatArray, H: FloatArray) -> FloatArray:
    """Twenty terms of the RPC00B cubic, (n, 20)."""
    one = np.ones_like(L)
    return np.stack(
        [one, L, P, H, L * P, L * H, P * H, L * L, P * P, H * H, L * P * H, L**3, L * P * P,
         L * H * H, L * L * P, P**3, P * H * H, L * L * H, P * P * H, H**3],
        axis=-1,
    )  # fmt: skip


def _slopes(L: FloatArray, P: FloatArray, H: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Differentiate `cubic_terms` by L and by P, (n, 20) each."""
    zero, one = np.zeros_like(L), np.ones_like(L)
    by_lon = [zero, one, zero, zero, P, H, zero, 2 * L, zero, zero, P * H, 3 * L * L, P * P,
              H * H, 2 * L * P, zero, zero, 2 * L * H, zero, zero]  # fmt: skip
    by_lat = [zero, zero, one, zero, L, zero, H, zero, 2 * P, zero, L * H, zero, 2 * L * P,
              zero, L * L, 3 * P * P, H * H, zero, 2 * P * H, zero]  # fmt: skip
    return np.stack(by_lon, axis=-1), np.stack(by_lat, axis=-1)


def _invert(
    coefficients: FloatArray, image: FloatArray, H: FloatArray, start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Normalised ground (n, 2) of normalised `image` (n, 2) and whether it converged (n)."""
    line_num, line_den, samp_num, samp_den = coefficients
    ground = np.broadcast_to(start, image.shape).copy()
    step = np.full_like(ground, np.inf)
    for _ in range(_MAX_ITERATIONS):
        terms = cubic_terms(ground[:, 0], ground[:, 1], H)
        by_lon, by_lat = _slopes(ground[:, 0], ground[:, 1], H)
        line = line_num - image[:, :1] * line_den
        samp = samp_num - image[:, 1:] * samp_den
        f, g = np.sum(terms * line, axis=1), np.sum(terms * samp, axis=1)
        a, b = np.sum(by_lon * line, axis=1), np.sum(by_lat * line, axis=1)
        c, d = np.sum(by_lon * samp, axis=1), np.sum(by_lat * samp, axis=1)
        step = np.stack([f * d - g * b, g * a - f * c], axis=1) / (a * d - b * c)[:, None]
        ground -= step
        size = np.abs(step).sum(axis=1)
        if np.all(~(size > 1e-12)):
            break
    converged = (size < 1e-9) & (np.abs(ground).max(axis=1) < _MAX_DOMAIN)
    return ground, converged


def find_start(
    coefficients: FloatArray,
    line_range: tuple[float, float],
    samp_range: tuple[float, float],
) -> StartTable | None:
    """Fit the start to the model with `coefficients` (4, 20); None where it has no inverse.

    The ranges are of the normalised line and sample; the normalised height is within ±1.
    """
    with np.errstate(all="ignore"):
        return _find_start(coefficients, line_range, samp_range)


def _find_start(
    coefficients: FloatArray, line_range: tuple[float, float], samp_range: tuple[float, float]
) -> StartTable | None:
    offs = np.array([np.mean(line_range), np.mean(samp_range)])
    halves = np.array([abs(np.ptp(line_range)) / 2.0, abs(np.ptp(samp_range)) / 2.0])
    # Sizes and scales out of all proportion leave no width to work with.
    if not np.all(np.isfinite(1.0 / halves)) or not np.all(np.isfinite(halves)):
        return None
    centre, found = _invert(coefficients, offs[None], np.zeros(1), np.zeros(2))
    if not found[0]:
        centre, found = _invert(coefficients, np.zeros((1, 2)), np.zeros(1), np.zeros(2))
    if not found[0]:
        return None
    dens = cubic_terms(centre[:, 0], centre[:, 1], np.zeros(1))[0] @ coefficients[[1, 3]].T
    if not np.all(np.isfinite(1.0 / dens)):
        return None

    node = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    u, v, w = (grid.ravel() for grid in np.meshgrid(node, node, node, indexing="ij"))
    image = offs + halves * np.stack([u, v], axis=1)
    ground, converged = _invert(coefficients, image, w, centre[0])
    if converged.sum() > 60:
        terms = cubic_terms(u, v, w)[converged]
        fit = np.linalg.lstsq(terms, ground[converged], rcond=None)[0]
    else:
        fit = np.zeros((20, 2))
        fit[0] = centre[0]
    reached = np.concatenate([ground[converged], centre, [[-1.0, -1.0], [1.0, 1.0]]])
    low, high = reached.min(axis=0), reached.max(axis=0)
    # Three times as wide as what the image and the normalisation cover: the highest ground is
    # well inside also for the most oblique views, a repetition of the polynomials is not.
    middle, half = (low + high) / 2.0, 1.5 * (high - low)
    return StartTable(
        lon=fit[:, 0],
        lat=fit[:, 1],
        line_off=float(offs[0]),
        line_half=float(halves[0]),
        samp_off=float(offs[1]),
        samp_half=float(halves[1]),
        line_den=float(dens[0]),
        samp_den=float(dens[1]),
        lon_off=float(middle[0]),
        lon_half=float(half[0]),
        lat_off=float(middle[1]),
        lat_half=float(half[1]),
    )
