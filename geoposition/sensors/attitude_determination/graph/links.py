"""Gyro links between knots, linearised about the knots' present estimates; and how knots move."""

from __future__ import annotations

import numpy as np
from numba import njit

from geoposition.arrays import FloatArray
from geoposition.rotation import quat_multiply
from geoposition.sensors.attitude_determination.graph.chain import LinearChain, invert6
from geoposition.sensors.attitude_determination.preintegration import Links
from geoposition.sensors.attitude_determination.propagation import quat_of_turn, turn_of_quat


def linear_chain(
    links: Links,
    quat_xyzw: FloatArray,
    bias_rad_s: FloatArray,
    unit: FloatArray,
    star_H: FloatArray,
    star_g: FloatArray,
) -> LinearChain:
    """Links as a chain of unknown corrections in `unit`, (6 + p,) of a knot and the constants.

    The star quadratics are in these units already.
    """
    n, q = len(links.qbb), links.F.shape[2] - 3
    phi, psi = np.zeros((n, 6, 6)), np.zeros((n, 6, q))
    weight, misfit = np.empty((n, 6, 6)), np.empty((n, 6))
    _linear_links(
        links.quat_xyzw,
        links.E,
        links.F,
        links.Qaa,
        links.Qab,
        links.qbb,
        quat_xyzw,
        bias_rad_s,
        unit,
        phi,
        psi,
        weight,
        misfit,
    )
    return LinearChain(phi, psi, weight, misfit, star_H, star_g)


@njit(cache=True, error_model="numpy")
def _linear_links(
    turn: FloatArray,
    E: FloatArray,
    F: FloatArray,
    Qaa: FloatArray,
    Qab: FloatArray,
    qbb: FloatArray,
    quat: FloatArray,
    bias: FloatArray,
    unit: FloatArray,
    phi: FloatArray,
    psi: FloatArray,
    weight: FloatArray,
    misfit: FloatArray,
) -> None:
    Q, work = np.zeros((6, 6)), np.empty((2, 6, 6))
    for i in range(len(turn)):
        for r in range(3):
            phi[i, 3 + r, 3 + r] = 1.0
            Q[3 + r, 3 + r] = qbb[i] / unit[3 + r] ** 2
            for c in range(3):
                phi[i, r, c] = E[i, r, c] * unit[c] / unit[r]
                phi[i, r, 3 + c] = F[i, r, c] * unit[3 + c] / unit[r]
                Q[r, c] = Qaa[i, r, c] / (unit[r] * unit[c])
                Q[r, 3 + c] = Qab[i, r, c] / (unit[r] * unit[3 + c])
                Q[3 + c, r] = Q[r, 3 + c]
            for c in range(psi.shape[2]):
                psi[i, r, c] = F[i, r, 3 + c] * unit[6 + c] / unit[r]
        invert6(Q, weight[i], work)
        x, y, z, w = quat_multiply(
            quat[i, 0], quat[i, 1], quat[i, 2], quat[i, 3], *_components(turn[i])
        )
        x, y, z, w = quat_multiply(-x, -y, -z, w, *_components(quat[i + 1]))
        x, y, z = turn_of_quat(x, y, z, w)
        misfit[i, 0], misfit[i, 1], misfit[i, 2] = x / unit[0], y / unit[1], z / unit[2]
        for r in range(3):
            misfit[i, 3 + r] = (bias[i + 1, r] - bias[i, r]) / unit[3 + r]


@njit(cache=True, error_model="numpy")
def _components(quat: FloatArray) -> tuple[float, float, float, float]:
    return quat[0], quat[1], quat[2], quat[3]


@njit(cache=True, error_model="numpy")
def move_knots(
    change: FloatArray, unit: FloatArray, quat_xyzw: FloatArray, bias_rad_s: FloatArray
) -> float:
    """Correct knots in place by `change` (k, 6) in `unit`; return its largest entry."""
    largest = 0.0
    for i in range(len(change)):
        x, y, z, w = quat_of_turn(
            change[i, 0] * unit[0], change[i, 1] * unit[1], change[i, 2] * unit[2]
        )
        x, y, z, w = quat_multiply(*_components(quat_xyzw[i]), x, y, z, w)
        scale = 1.0 / np.sqrt(x * x + y * y + z * z + w * w)
        quat_xyzw[i, 0], quat_xyzw[i, 1] = scale * x, scale * y
        quat_xyzw[i, 2], quat_xyzw[i, 3] = scale * z, scale * w
        for r in range(3):
            bias_rad_s[i, r] += change[i, 3 + r] * unit[3 + r]
        for r in range(6):
            largest = max(largest, abs(change[i, r]))
    return largest
