"""Angles between the optical axes of star heads: what stays constant on a stiff satellite.

Scatter, drift and bends of these angles show the heads' own errors, whatever the satellite does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import BoolArray, FloatArray, IntArray, read_only
from geoposition.errors import ArgumentError, GeometryError
from geoposition.sensors.telemetry import StarSeries

_ARCSEC_RAD = np.pi / 648000.0
_SAME_EPOCH_S = 1e-6
_GAP_STEPS = 2.5
"""Two heads are not matched across a step longer than so many of the usual ones."""


@dataclass(frozen=True, slots=True, eq=False)
class AxisAngle:
    """Angle between the boresights of two heads over time.

    `angle_rad` (n,) at `times_s` (n,); `std_rad` is the RMS about the mean `mean_rad`;
    `drift_rad_s` the slope of a straight line through the angles, with its `drift_sigma_rad_s`
    (NaN below 3 epochs), and `noise_rad` the scatter about that line.
    """

    sensors: tuple[str, str]
    times_s: FloatArray
    angle_rad: FloatArray
    mean_rad: float
    std_rad: float
    drift_rad_s: float
    drift_sigma_rad_s: float
    noise_rad: float

    def summary(self) -> Mapping[str, object]:
        """Figures as tables and JSON state them, in degrees and arc seconds."""
        return {
            "sensors": list(self.sensors),
            "mean_deg": float(np.degrees(self.mean_rad)),
            "std_arcsec": self.std_rad / _ARCSEC_RAD,
            "drift_arcsec_per_h": self.drift_rad_s / _ARCSEC_RAD * 3600.0,
            "drift_sigma_arcsec_per_h": self.drift_sigma_rad_s / _ARCSEC_RAD * 3600.0,
            "detrended_std_arcsec": self.noise_rad / _ARCSEC_RAD,
            "n": len(self.times_s),
        }


def boresight_inertial(R_inertial_sensor: Rotation) -> FloatArray:
    """Return unit vectors (n, 3) of the optical axes, the sensors' +z. *Source*: T (2.36)."""
    return np.asarray(R_inertial_sensor.apply([0.0, 0.0, 1.0]))


def angle_between_rad(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angles (...) between vectors (..., 3), right to rounding also near 0 and pi.

    *Source*: T (2.37), whose arc cosine loses half the digits there.
    """
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.arctan2(cross, np.einsum("...i,...i->...", a, b)))


def axis_angles(star: StarSeries) -> tuple[AxisAngle, ...]:
    """Angles of every pair of heads with epochs in common.

    Where the heads are not read at the same epochs, the denser one is interpolated to the other's
    (cubic through four rotations), never across a gap. No pair at all is a `GeometryError`.
    """
    present = np.unique(star.head)
    if len(present) < 2:
        raise GeometryError(f"axis angles: two star heads expected, there is {len(present)}")
    pairs = []
    for a, b in combinations(present.tolist(), 2):
        times, first, second = matched_heads(star, a, b)
        if len(times) > 0:
            angle = angle_between_rad(boresight_inertial(first), boresight_inertial(second))
            pairs.append(_statistics((star.heads[a], star.heads[b]), times, angle))
    if not pairs:
        raise GeometryError("axis angles: no two heads were read at the same time")
    return tuple(pairs)


def matched_heads(star: StarSeries, a: int, b: int) -> tuple[FloatArray, Rotation, Rotation]:
    """Find common epochs (n,) of heads `a` and `b`, and both rotations R_inertial_sensor."""
    series = [star.where(star.head == head) for head in (a, b)]
    if not all(len(s) for s in series):
        raise ArgumentError(f"star heads {a} and {b}: samples of both expected")
    swapped = len(series[0]) > len(series[1])
    sparse, dense = series[::-1] if swapped else series
    keep, turned = interpolate_rotations(dense.times_s, dense.R_inertial_sensor, sparse.times_s)
    kept = sparse.where(keep)
    if len(kept) == 0:
        return kept.times_s, Rotation.identity(0), Rotation.identity(0)
    one = kept.R_inertial_sensor
    return (kept.times_s, turned, one) if swapped else (kept.times_s, one, turned)


def interpolate_rotations(
    times_s: FloatArray, rotations: Rotation, at_s: FloatArray
) -> tuple[BoolArray, Rotation]:
    """Where in `at_s` (m,) a series (n,) can answer, and its rotations there.

    A coinciding sample is taken as it is; else a cubic runs through the rotation vectors of the
    four neighbours (a line through two where gaps leave no four).
    """
    n = len(times_s)
    nearest = np.clip(np.searchsorted(times_s, at_s), 0, n - 1)
    left = np.clip(nearest - 1, 0, n - 1)
    nearest = np.where(
        np.abs(times_s[left] - at_s) < np.abs(times_s[nearest] - at_s), left, nearest
    )
    same = np.abs(times_s[nearest] - at_s) <= _SAME_EPOCH_S
    steps = np.diff(times_s)
    usual = np.median(steps) if n > 1 else 0.0
    whole = steps <= _GAP_STEPS * usual
    start = np.clip(np.searchsorted(times_s, at_s, side="right") - 1, 0, max(n - 2, 0))
    inside = (at_s >= times_s[0]) & (at_s <= times_s[-1]) & (n > 1)
    inside &= whole[start] if n > 1 else False
    keep = same | inside
    if not np.any(keep):
        return keep, Rotation.identity(0)
    centre = rotations[nearest[keep]]
    vectors = np.zeros((int(keep.sum()), 3))
    between = (inside & ~same)[keep]
    if np.any(between):
        first, at = start[keep][between], at_s[keep][between]
        index, four = _four_neighbours(first, whole)
        knots = times_s[index]
        weight = np.zeros((len(first), 4))
        weight[four] = _lagrange_weights(knots[four], at[four])
        weight[~four, 1:3] = _lagrange_weights(knots[~four, 1:3], at[~four])
        base = centre[between]
        for k in range(4):
            relative = (base.inv() * rotations[index[:, k]]).as_rotvec()
            vectors[between] += weight[:, k, None] * relative
    return keep, centre * Rotation.from_rotvec(vectors)


def _four_neighbours(first: IntArray, whole: BoolArray) -> tuple[IntArray, BoolArray]:
    """Find samples (m, 4) around steps `first` (m,), and whether no gap is among them.

    The step is the middle one of three where it can be. Beside gaps only the inner two count.
    """
    steps = np.concatenate([[False, False], whole, [False, False]])
    index = first[:, None] + np.arange(-1, 3)
    four = np.zeros(len(first), dtype=np.bool_)
    for shift in (0, 1, -1):
        lowest = first - 1 + shift
        unbroken = steps[lowest + 2] & steps[lowest + 3] & steps[lowest + 4] & ~four
        index[unbroken] = lowest[unbroken, None] + np.arange(4)
        four |= unbroken
    return np.clip(index, 0, len(whole)), four


def _lagrange_weights(knots: FloatArray, at: FloatArray) -> FloatArray:
    weights = np.ones_like(knots)
    for k in range(knots.shape[1]):
        for other in range(knots.shape[1]):
            if other != k:
                weights[:, k] *= (at - knots[:, other]) / (knots[:, k] - knots[:, other])
    return weights


def _statistics(sensors: tuple[str, str], times: FloatArray, angle: FloatArray) -> AxisAngle:
    n = len(times)
    mean = float(np.mean(angle))
    std = float(np.std(angle)) if n > 1 else float("nan")
    slope = sigma = noise = float("nan")
    if n > 2:
        offset = times - np.mean(times)
        spread = float(offset @ offset)
        slope = float(offset @ (angle - mean)) / spread
        residual = angle - mean - slope * offset
        noise = float(np.sqrt(residual @ residual / (n - 2)))
        sigma = noise / np.sqrt(spread)
    return AxisAngle(
        sensors, read_only(times), read_only(angle), mean, std, slope, float(sigma), noise
    )
