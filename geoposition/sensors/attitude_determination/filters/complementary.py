"""Complementary filter: star sensor below a cut-off, gyro above it; and T's CF before the UKF.

`filter_forward` has fixed gains of its cut-off frequency alone. Below it the attitude follows the
star sensor, above it the gyro, and the gyro's drift is the integral of what they differ by: two
equal real poles, discretised exactly for the time between star epochs. Its covariance is that of
these gains (Joseph's form), so it is right for the stated noise, though larger than the optimum's.

`cf_ukf` is T 3.2.3: prediction and star sample first go through a complementary filter, whose
output the unscented filter takes as its measurement. That output holds the prediction itself,
which T's measurement noise does not know of: the star sample's share g of the output is taken to
have g² of its noise variance, and nothing is said of the share 1 − g. The stated covariance is
therefore too small, the more so the lower the cut-off, and with it the gains: below about half the
star sensor's rate the estimate itself suffers (`experiment thesis-ch3` prints both). As the cut-off
grows the plain unscented filter comes back; it is never beaten. Take no covariance from this.

*Source*: T 3.2.3, (3.34), fig. 3.6–3.7; Higgins 1975; Mahony, Hamel & Pflimlin 2008.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.errors import ArgumentError
from geoposition.rotation import quat_multiply
from geoposition.sensors.attitude_determination.checks.convention_check import (
    refuse_wrong_convention,
)
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate
from geoposition.sensors.attitude_determination.filters.filter_kernels import (
    predict_covariance,
    update_covariance,
)
from geoposition.sensors.attitude_determination.filters.forward import (
    ForwardPass,
    begin,
    estimate_of,
    gate_threshold,
)
from geoposition.sensors.attitude_determination.filters.ukf import SigmaPoints, run_unscented
from geoposition.sensors.attitude_determination.propagation import (
    inverse3,
    process_noise,
    quat_of_turn,
    times_matrix,
    transition,
    turn_of_quat,
)
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.timeline import Timeline, merge
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries

_HALF_POWER: Final = math.sqrt(3.0 + math.sqrt(10.0))
"""Where (2 s + 1) / (s + 1)² has half its power: the cut-off, in units of the double pole."""


def filter_forward(
    star: StarSeries,
    gyro: GyroSeries,
    settings: FusionSettings,
    mounting: Mounting = Mounting(),  # noqa: B008  (frozen)
    cutoff_hz: float = 0.1,
) -> AttitudeEstimate:
    """Attitude at the gyro epochs from the first usable star sample on, bias model only.

    At `cutoff_hz` half the power of the star sensor's error passes. Samples that fail the gate are
    left out; several of one epoch are averaged by their weights.
    """
    if settings.model != "bias":
        raise ArgumentError("complementary filter: it estimates drift only, model bias expected")
    refuse_wrong_convention(star, gyro, mounting)
    done = run_complementary(merge(star, gyro, mounting), settings, cutoff_hz)
    return estimate_of(done, done.first, len(star))


def cf_ukf(
    star: StarSeries,
    gyro: GyroSeries,
    settings: FusionSettings,
    mounting: Mounting = Mounting(),  # noqa: B008  (frozen)
    cutoff_hz: float = 1.0,
    points: SigmaPoints = SigmaPoints(),  # noqa: B008  (frozen)
) -> AttitudeEstimate:
    """T's complementary and unscented filter; its covariance and innovations are not consistent.

    `cutoff_hz` is the corner of the complementary filter of first order.
    """
    refuse_wrong_convention(star, gyro, mounting)
    corner = 2.0 * np.pi * _positive(cutoff_hz)
    done = run_unscented(merge(star, gyro, mounting), settings, points, corner)
    return estimate_of(done, done.first, len(star))


def run_complementary(
    timeline: Timeline, settings: FusionSettings, cutoff_hz: float
) -> ForwardPass:
    """Filter a timeline from its first usable star sample on."""
    done = begin(timeline, settings)
    _complementary_pass(
        (0,) * 6,
        done.first,
        timeline.times_s,
        timeline.turn_rad,
        timeline.extra_rad2,
        timeline.star_start,
        timeline.quat_inertial_body,
        timeline.covariance_rad2,
        done.walks,
        gate_threshold(settings),
        2.0 * np.pi * _positive(cutoff_hz) / _HALF_POWER,
        done.quat_xyzw,
        done.rest,
        done.covariance,
        done.residual_rad,
        done.innovation_rad2,
        done.gain,
        done.accepted,
    )
    return done


def _positive(cutoff_hz: float) -> float:
    if not 0.0 < cutoff_hz < float("inf"):
        raise ArgumentError("complementary filter: a positive cut-off frequency expected")
    return cutoff_hz


@njit(cache=True, error_model="numpy", nogil=True)
def _complementary_pass(
    token: tuple[int, ...],
    first: int,
    times_s: FloatArray,
    measured_rad: FloatArray,
    extra_rad2: FloatArray,
    star_start: IntArray,
    star_quat: FloatArray,
    star_covariance: FloatArray,
    walks: tuple[float, float],
    gate: float,
    pole_rad_s: float,
    quat: FloatArray,
    bias: FloatArray,
    P: FloatArray,
    residual: FloatArray,
    S: FloatArray,
    K: FloatArray,
    accepted: BoolArray,
) -> None:
    sv2, su2 = walks
    A, B, L2, M = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.eye(3)
    Qdd, Qdb, inverse = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    strips, square, gains = np.empty((6, 3)), np.empty((6, 6)), np.zeros((6, 3))
    weight, weighted = np.empty((3, 3)), np.empty(3)
    b, cov = bias[first].copy(), P[first].copy()
    qx, qy, qz, qw = quat[first, 0], quat[first, 1], quat[first, 2], quat[first, 3]
    star_time = times_s[first]
    for k in range(first, len(quat)):
        if k > first:
            step = times_s[k] - times_s[k - 1]
            x = measured_rad[k - 1, 0] - b[0] * step
            y = measured_rad[k - 1, 1] - b[1] * step
            z = measured_rad[k - 1, 2] - b[2] * step
            factors = transition(token, x, y, z, step, M, A, B, L2)
            process_noise(
                token, x, y, z, step, sv2, su2, extra_rad2[k - 1], factors, M, L2, Qdd, Qdb
            )
            predict_covariance(token, cov, A, B, Qdd, Qdb, su2 * step, strips)
            px, py, pz, pw = quat_of_turn(x, y, z)
            qx, qy, qz, qw = quat_multiply(qx, qy, qz, qw, px, py, pz, pw)
        used = 0
        weight[:, :] = 0.0
        weighted[:] = 0.0
        for m in range(star_start[k], star_start[k + 1]):
            if k == first and accepted[m]:
                continue
            px, py, pz, pw = quat_multiply(
                -qx,
                -qy,
                -qz,
                qw,
                star_quat[m, 0],
                star_quat[m, 1],
                star_quat[m, 2],
                star_quat[m, 3],
            )
            x, y, z = turn_of_quat(px, py, pz, pw)
            residual[m, 0], residual[m, 1], residual[m, 2] = x, y, z
            S[m] = star_covariance[m] + cov[:3, :3]
            inverse3(S[m], inverse)
            u, v, w = times_matrix(inverse, x, y, z)
            accepted[m] = x * u + y * v + z * w <= gate
            if accepted[m]:
                used += 1
                inverse3(star_covariance[m], inverse)
                u, v, w = times_matrix(inverse, x, y, z)
                weighted[0] += u
                weighted[1] += v
                weighted[2] += w
                weight += inverse
        elapsed = times_s[k] - star_time
        if used > 0 and elapsed > 0.0:
            star_time = times_s[k]
            pole = math.exp(-pole_rad_s * elapsed)
            inverse3(weight, inverse)
            x, y, z = times_matrix(inverse, weighted[0], weighted[1], weighted[2])
            # Both roots of (z − 1)² + (g + h) (z − 1) + h = 0 at the pole: g attitude, h drift.
            g = 1.0 - pole * pole
            h = (1.0 - pole) ** 2 / elapsed
            for i in range(3):
                gains[i, i], gains[3 + i, i] = g, -h
            update_covariance(token, cov, inverse, gains, square)
            for m in range(star_start[k], star_start[k + 1]):
                K[m] = gains
            b[0] -= h * x
            b[1] -= h * y
            b[2] -= h * z
            px, py, pz, pw = quat_of_turn(g * x, g * y, g * z)
            qx, qy, qz, qw = quat_multiply(qx, qy, qz, qw, px, py, pz, pw)
        scale = 1.0 / math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
        qx, qy, qz, qw = qx * scale, qy * scale, qz * scale, qw * scale
        quat[k, 0], quat[k, 1], quat[k, 2], quat[k, 3] = qx, qy, qz, qw
        bias[k] = b
        P[k] = cov
