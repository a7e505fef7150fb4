"""Many runs of one scene: Monte Carlo of filter and smoothers, on all cores.

The kernels release the interpreter's lock, so threads suffice, and what a table says is said of
the same code that estimates one run.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.rotation import quat_multiply
from geoposition.sensors.attitude_determination.filters.forward import run_forward
from geoposition.sensors.attitude_determination.propagation import turn_of_quat
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.attitude_determination.smoothers.smooth import smooth_timeline
from geoposition.sensors.attitude_determination.timeline import Timeline

BatchMethod: TypeAlias = Literal["ekf", "rts", "two-filter"]


@dataclass(frozen=True, slots=True, eq=False)
class Probe:
    """State of all runs at one knot: `quat_xyzw` (r, 4), `rest` (r, s − 3), `covariance`."""

    quat_xyzw: FloatArray
    rest: FloatArray
    covariance: FloatArray

    def error(self, true_quat_xyzw: FloatArray, true_rest: FloatArray) -> FloatArray:
        """Error states (r, s): what takes the estimates to the truth (r or 1, ...)."""
        estimate = Rotation.from_quat(self.quat_xyzw)
        turn = (estimate.inv() * Rotation.from_quat(np.array(true_quat_xyzw))).as_rotvec()
        return np.concatenate([turn, true_rest - self.rest], axis=1)

    def nees(self, true_quat_xyzw: FloatArray, true_rest: FloatArray) -> FloatArray:
        """Normalised estimation error squared (r,), chi-squared with s degrees of freedom."""
        error = self.error(true_quat_xyzw, true_rest)
        sigma = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        scaled = self.covariance / (sigma[:, :, None] * sigma[:, None, :])
        unit = error / sigma
        return np.asarray(
            np.einsum("ri,ri->r", unit, np.linalg.solve(scaled, unit[..., None])[..., 0])
        )


@dataclass(frozen=True, slots=True, eq=False)
class BatchResult:
    """Per run: RMS attitude error `rms_rad` (r, 3) about each axis over all knots, and more.

    `nis` (r,) is the mean normalised squared innovation, of the filter that a smoother began
    with; `first`, `middle`, `last` the states at these knots.
    """

    rms_rad: FloatArray
    nis: FloatArray
    first: Probe
    middle: Probe
    last: Probe


def run_batch(
    timelines: Sequence[Timeline],
    truth_quat_xyzw: FloatArray,
    settings: FusionSettings,
    method: BatchMethod = "ekf",
) -> BatchResult:
    """Estimate runs that share their knots and their true attitude `truth_quat_xyzw` (k, 4).

    The first star sample is at the first knot.
    """
    runs, n = len(timelines), settings.states
    rms, nis = np.empty((runs, 3)), np.empty(runs)
    quat, rest = np.empty((3, runs, 4)), np.empty((3, runs, n - 3))
    covariance = np.empty((3, runs, n, n))

    def one(run: int) -> None:
        if method == "ekf":
            done = run_forward(timelines[run], settings)
        else:
            done = smooth_timeline(timelines[run], settings, method)
        _rms_error(truth_quat_xyzw, done.quat_xyzw, rms[run])
        met = np.isfinite(done.residual_rad[:, 0])
        z, S = done.residual_rad[met], done.innovation_rad2[met]
        nis[run] = np.mean(np.einsum("mi,mij,mj->m", z, np.linalg.inv(S), z))
        last = len(done.quat_xyzw) - 1
        for place, knot in enumerate((0, last // 2, last)):
            quat[place, run] = done.quat_xyzw[knot]
            rest[place, run] = done.rest[knot]
            covariance[place, run] = done.covariance[knot]

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(one, range(runs)))
    probes = [Probe(quat[i], rest[i], covariance[i]) for i in range(3)]
    return BatchResult(rms, nis, *probes)


@njit(cache=True, error_model="numpy", nogil=True)
def _rms_error(truth: FloatArray, quat: FloatArray, out: FloatArray) -> None:
    out[:] = 0.0
    for k in range(len(quat)):
        a, b, c, d = quat[k, 0], quat[k, 1], quat[k, 2], quat[k, 3]
        p, q, r, s = truth[k, 0], truth[k, 1], truth[k, 2], truth[k, 3]
        x, y, z, w = quat_multiply(-a, -b, -c, d, p, q, r, s)
        x, y, z = turn_of_quat(x, y, z, w)
        out[0] += x * x
        out[1] += y * y
        out[2] += z * z
    for i in range(3):
        out[i] = np.sqrt(out[i] / len(quat))
