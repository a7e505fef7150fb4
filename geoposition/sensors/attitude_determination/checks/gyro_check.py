"""Is the gyro valid? Its integrated turns against the star sensor's, and what explains the rest.

Bias, its drift, scale and misalignment, and the lag between the clocks are fitted to what is left
between the two; intervals that stay off are suspicious, and say which of the two is to blame.
*Source*: T 2.3.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import BoolArray, FlagArray, FloatArray, IntArray, read_only
from geoposition.errors import ArgumentError, GeometryError
from geoposition.sensors.attitude_determination.checks.axis_angle import interpolate_rotations
from geoposition.sensors.attitude_determination.checks.convention_check import check_conventions
from geoposition.sensors.attitude_determination.checks.gyro_fit import GyroFit, fit_gyro_errors
from geoposition.sensors.attitude_determination.checks.gyro_intervals import (
    GyroTrack,
    Intervals,
    intervals_of_head,
)
from geoposition.sensors.attitude_determination.checks.gyro_messages import messages
from geoposition.sensors.attitude_determination.checks.gyro_samples import (
    GyroFlag,
    excess_turn_rad,
    suspicious_samples,
)
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries

_ARCSEC_RAD: Final = np.pi / 648000.0
_LAG_PASSES: Final = 3
_SURE: Final = 3.0
_EXPLAINED: Final = 0.3
"""Spikes that leave less of an interval's disagreement are all that is wrong in it."""


@dataclass(frozen=True, slots=True)
class GyroCheckSettings:
    """Length of the intervals (None: a hundredth of the overlap, 10 to 60 s), and when one is off.

    An interval is suspicious if it is off by more than `threshold_sigma` of the usual scatter.
    """

    interval_s: float | None = None
    threshold_sigma: float = 5.0

    def __post_init__(self) -> None:
        if self.interval_s is not None and not 0.0 < self.interval_s < np.inf:
            raise ArgumentError("gyro check: a positive interval expected")
        if not self.threshold_sigma > 0.0:
            raise ArgumentError("gyro check: a positive threshold expected")


@dataclass(frozen=True, slots=True, eq=False)
class GyroCheck:
    """What the comparison found.

    `bias_rad_s` (3,) at the middle of the gyro's span, `drift_rad_s2` (3,), S `scale` (3, 3)
    (measured = (I + S) true + bias) and `lag_s` (by how much star epochs are late against the
    gyro's), each with a sigma and NaN where the motion does not show it. Of intervals (m,):
    `start_s`, `end_s`, `head`, `difference_rad` (m, 3) star minus gyro, `residual_rad` (m, 3)
    after the fit, `suspicious`. `deviation_rad` (k, 3) at `deviation_times_s` (k,) is star minus
    gyro since the first common star sample of each head. `sample_flag` (n,) belongs to the gyro's
    samples (`GyroFlag`), `star_suspect` lists star samples to blame. `messages` say in words
    what is wrong; `valid` if nothing is.
    """

    valid: bool
    messages: tuple[str, ...]
    bias_rad_s: FloatArray
    bias_sigma_rad_s: FloatArray
    drift_rad_s2: FloatArray
    drift_sigma_rad_s2: FloatArray
    scale: FloatArray
    scale_sigma: FloatArray
    lag_s: float
    lag_sigma_s: float
    start_s: FloatArray
    end_s: FloatArray
    head: IntArray
    difference_rad: FloatArray
    residual_rad: FloatArray
    suspicious: BoolArray
    deviation_times_s: FloatArray
    deviation_rad: FloatArray
    sample_flag: FlagArray
    star_suspect: IntArray

    def summary(self) -> Mapping[str, object]:
        """Figures as tables and JSON state them; None where the motion does not show one."""
        hour, rms = 3600.0 / _ARCSEC_RAD, np.sqrt(np.mean(self.residual_rad**2, axis=0))
        return {
            "valid": self.valid,
            "messages": list(self.messages),
            "bias_deg_h": _listed(np.degrees(self.bias_rad_s) * 3600.0),
            "bias_sigma_deg_h": _listed(np.degrees(self.bias_sigma_rad_s) * 3600.0),
            "bias_arcsec_s": _listed(self.bias_rad_s / _ARCSEC_RAD),
            "drift_arcsec_s_per_h": _listed(self.drift_rad_s2 * hour),
            "scale_ppm": [_listed(row) for row in self.scale * 1e6],
            "scale_sigma_ppm": [_listed(row) for row in self.scale_sigma * 1e6],
            "lag_s": _listed([self.lag_s])[0],
            "lag_sigma_s": _listed([self.lag_sigma_s])[0],
            "intervals": len(self.start_s),
            "interval_s": float(np.median(self.end_s - self.start_s)),
            "difference_rms_arcsec": _listed(
                np.sqrt(np.mean(self.difference_rad**2, axis=0)) / _ARCSEC_RAD
            ),
            "residual_rms_arcsec": _listed(rms / _ARCSEC_RAD),
            "suspicious_intervals": int(np.sum(self.suspicious)),
            "suspicious_gyro_samples": int(np.sum(self.sample_flag != GyroFlag.OK)),
            "suspicious_star_samples": len(self.star_suspect),
        }


def check_gyro(
    star: StarSeries,
    gyro: GyroSeries,
    mounting: Mounting | None = None,
    settings: GyroCheckSettings | None = None,
) -> GyroCheck:
    """Compare a gyro with the star heads over their common span.

    Fewer than 3 intervals in common are a `GeometryError`.
    """
    chosen = settings or GyroCheckSettings()
    mounting = mounting or Mounting()
    first = max(star.times_s[0], gyro.times_s[0])
    last = min(star.times_s[-1], gyro.times_s[-1])
    if not first < last:
        raise GeometryError(
            f"gyro check: star data {star.times_s[0]:.3f} .. {star.times_s[-1]:.3f} s never "
            f"overlaps the gyro's {gyro.times_s[0]:.3f} .. {gyro.times_s[-1]:.3f} s"
        )
    interval = chosen.interval_s or float(np.clip((last - first) / 100.0, 10.0, 60.0))
    interval = min(interval, (last - first) / 4.0) if chosen.interval_s is None else interval
    track = GyroTrack.of(gyro)
    parts, fit, lag = _fitted(star, track, mounting, interval, chosen.threshold_sigma)
    value, sigma = np.append(fit.value[:-1], lag), fit.sigma
    flags, star_suspect = _blame(parts, fit, gyro)
    times, deviation = _deviation(star, track, mounting)
    said = messages(
        gyro, check_conventions(star, gyro, mounting), value, sigma, flags, len(star_suspect)
    )
    return GyroCheck(
        valid=not said,
        messages=said,
        bias_rad_s=read_only(value[:3]),
        bias_sigma_rad_s=read_only(sigma[:3]),
        drift_rad_s2=read_only(value[3:6]),
        drift_sigma_rad_s2=read_only(sigma[3:6]),
        scale=read_only(value[6:15].reshape(3, 3)),
        scale_sigma=read_only(sigma[6:15].reshape(3, 3)),
        lag_s=float(value[15]),
        lag_sigma_s=float(sigma[15]),
        start_s=read_only(np.concatenate([part.start_s for part in parts])),
        end_s=read_only(np.concatenate([part.end_s for part in parts])),
        head=np.concatenate([np.full(len(part.first), part.head) for part in parts]),
        difference_rad=read_only(np.concatenate([part.difference_rad for part in parts])),
        residual_rad=read_only(np.concatenate(fit.residuals_rad)),
        suspicious=np.concatenate(fit.suspicious),
        deviation_times_s=read_only(times),
        deviation_rad=read_only(deviation),
        sample_flag=flags,
        star_suspect=star_suspect,
    )


def _fitted(
    star: StarSeries, track: GyroTrack, mounting: Mounting, interval_s: float, threshold: float
) -> tuple[list[Intervals], GyroFit, float]:
    """Intervals, their fit and the whole lag: the design is linear in it, so it is removed."""
    lag = 0.0
    for again in range(_LAG_PASSES):
        shifted = replace(star, times_s=read_only(star.times_s - lag))
        found = [
            intervals_of_head(shifted, track, mounting, head, interval_s)
            for head in range(len(star.heads))
        ]
        parts = [part for part in found if part is not None]
        if sum(len(part.first) for part in parts) < 3:
            raise GeometryError(
                f"gyro check: fewer than 3 intervals of {interval_s:.4g} s have star and gyro data"
            )
        fit = fit_gyro_errors(parts, threshold)
        shift, sigma = float(fit.value[-1]), float(fit.sigma[-1])
        if again == _LAG_PASSES - 1 or not abs(shift) > _SURE * sigma:
            break
        lag += shift
    return parts, fit, lag + shift


def _blame(parts: list[Intervals], fit: GyroFit, gyro: GyroSeries) -> tuple[FlagArray, IntArray]:
    """Star samples that spoil both their intervals; gyro samples in the other bad intervals."""
    flags = suspicious_samples(gyro)
    excess = excess_turn_rad(gyro)
    blamed = []
    for part, residual, bad in zip(parts, fit.residuals_rad, fit.suspicious, strict=True):
        both = np.flatnonzero(part.chained & bad[1:] & bad[:-1])
        opposed = np.einsum("ij,ij->i", residual[both], residual[both + 1]) < 0.0
        by_star = np.zeros(len(bad), dtype=bool)
        by_star[both[opposed]] = True
        by_star[both[opposed] + 1] = True
        blamed.append(part.last[both[opposed]])
        for k in np.flatnonzero(bad & ~by_star):
            inside = (gyro.times_s >= part.start_s[k]) & (gyro.times_s <= part.end_s[k])
            spikes = excess[inside & (flags == GyroFlag.SPIKE)].sum(axis=0)
            left = np.linalg.norm(residual[k] + spikes) / np.linalg.norm(residual[k])
            if left > _EXPLAINED and not np.any(flags[inside] == GyroFlag.STUCK):
                flags[inside & (flags == GyroFlag.OK)] = GyroFlag.DISAGREES
    flags.setflags(write=False)
    return flags, np.unique(np.concatenate(blamed)).astype(np.int64)


def _deviation(
    star: StarSeries, track: GyroTrack, mounting: Mounting
) -> tuple[FloatArray, FloatArray]:
    times, deviations = [], []
    for head, name in enumerate(star.heads):
        mine = star.where(star.head == head)
        if len(mine) == 0:
            continue
        known, turned = interpolate_rotations(track.times_s, track.turned, mine.times_s)
        if not np.any(known):
            continue
        kept = Rotation.from_quat(np.array(mine.quat_xyzw[known]))
        offset = turned.inv() * (kept * mounting.rotation(name).inv())
        # offset is G⁻¹ R0 G exp(error): R0 from the first sample.
        R0 = (turned * offset * turned.inv())[0]
        deviations.append((turned.inv() * R0.inv() * turned * offset).as_rotvec())
        times.append(mine.times_s[known])
    all_times = np.concatenate(times)
    order = np.argsort(all_times, kind="stable")
    return all_times[order], np.concatenate(deviations)[order]


def _listed(values: object) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in np.asarray(values, dtype=np.float64)]
