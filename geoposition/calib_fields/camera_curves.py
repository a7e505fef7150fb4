"""A calibrated camera's curves over the image row, with their deviations.

A turn r of the camera moves the tangents (x, y) of a direction by
    (r_y (1 + x²) − r_x x y − r_z y,  r_z x − r_x (1 + y²) + r_y x y),
so that constant and tilted look angles are turns too: only what is left after the turn that fits
best, the shape, is the look angles' own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.adjust import Adjustment
from geoposition.adjust.residuals import look_functions
from geoposition.arrays import FloatArray, IntArray
from geoposition.calib_fields.calibration import LookCurve
from geoposition.camera import Camera

_POINTS: Final = 65


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Curves by CCD, and the turn of the mounting (3,) with its deviation."""

    looks: tuple[LookCurve, ...]
    mounting_rad: FloatArray
    mounting_sigma_rad: FloatArray


def camera_curves(base: Camera, done: Adjustment, reference_rad: float) -> Curves:
    """Curves of what an adjustment changed in the camera `base`, in pixels.

    `reference_rad` is the deviation of the reference's place, as seen from the satellite: it
    turns the whole camera about both axes across its sight.
    """
    columns, values, covariance = _of_camera(done)
    covariance[[0, 1], [0, 1]] += reference_rad**2
    samples = [
        np.linspace(d.first_sample, d.last_sample, _POINTS if d.last_sample > d.first_sample else 1)
        for d in base.detectors
    ]
    tangents = np.concatenate([base.tangents(k, s) for k, s in enumerate(samples)])
    turns = turn_terms(tangents)
    terms = np.concatenate([turns, _look_terms(base, done, np.concatenate(samples))], axis=-1)
    flat, flat_turns = terms.reshape(-1, len(columns)), turns.reshape(-1, 3)
    shape = flat - flat_turns @ np.linalg.lstsq(flat_turns, flat, rcond=None)[0]
    pixel = pixel_angle_rad(base)
    out, at = [], 0
    for number, own in enumerate(samples):
        rows = slice(2 * at, 2 * (at + len(own)))
        at += len(own)
        change, sigma = _spread(flat[rows], values, covariance, pixel)
        shaped, shape_sigma = _spread(shape[rows], values, covariance, pixel)
        out.append(LookCurve(number, own, change, sigma, shaped, shape_sigma))
    mounting_sigma = np.sqrt(np.diagonal(covariance)[:3])
    return Curves(tuple(out), values[:3], mounting_sigma)


def turn_terms(tangents: FloatArray) -> FloatArray:
    """Return derivatives (n, 2, 3) of tangents (n, 2) by a turn of the camera about its axes."""
    x, y = tangents.T
    one_x = np.stack([-x * y, 1.0 + x * x, -y], axis=-1)
    one_y = np.stack([-(1.0 + y * y), x * y, x], axis=-1)
    return np.stack([one_x, one_y], axis=1)


def pixel_angle_rad(camera: Camera) -> float:
    """Angle of a pixel in the middle of the camera's widest CCD."""
    widest = max(
        range(len(camera.detectors)),
        key=lambda k: camera.detectors[k].last_sample - camera.detectors[k].first_sample,
    )
    own = camera.detectors[widest]
    middle = 0.5 * (own.first_sample + own.last_sample)
    ends = camera.tangents(widest, np.array([middle - 0.5, middle + 0.5]))
    return float(np.hypot(*(ends[1] - ends[0])))


def _of_camera(done: Adjustment) -> tuple[IntArray, FloatArray, FloatArray]:
    """Columns of mounting and looks, in this order, with values and covariance."""
    columns: list[int] = []
    for kind in ("mounting", "look"):
        at = 0
        for block in done.blocks:
            if block.kind == kind:
                columns += range(at, at + len(block))
            at += len(block)
    index = np.array(columns, dtype=np.int64)
    return index, done.values[index], done.covariance[np.ix_(index, index)].copy()


def _look_terms(base: Camera, done: Adjustment, samples: FloatArray) -> FloatArray:
    """Return derivatives (n, 2, p) of the tangents of `samples` by the looks' unknowns."""
    parts = []
    for block in done.blocks:
        if block.kind == "look":
            functions = look_functions(block, base, samples)
            part = np.zeros((len(samples), 2, len(block)))
            part[:, 0, 0::2] = functions
            part[:, 1, 1::2] = functions
            parts.append(part)
    return np.concatenate(parts, axis=-1)


def _spread(
    terms: FloatArray, values: FloatArray, covariance: FloatArray, pixel_rad: float
) -> tuple[FloatArray, FloatArray]:
    change = (terms @ values).reshape(-1, 2) / pixel_rad
    variance = np.einsum("ij,jk,ik->i", terms, covariance, terms)
    sigma = np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 2) / pixel_rad
    return change, sigma


def correlations(done: Adjustment) -> dict[str, float]:
    """Largest correlation, by size, between unknowns of each two blocks' kinds."""
    sigma = done.sigma
    correlation = done.covariance / np.outer(sigma, sigma)
    kinds = np.array([block.kind for block in done.blocks for _ in range(len(block))])
    names = list(dict.fromkeys(kinds.tolist()))
    out = {}
    for i, a in enumerate(names):
        for b in names[i:]:
            part = np.abs(correlation[np.ix_(kinds == a, kinds == b)])
            if a == b:
                part = part - np.eye(len(part))
            out[f"{a} with {b}"] = float(part.max(initial=0.0))
    return out
