"""Many gyro steps as one relative measurement between two knots of a graph or a chain.

Between knots the gyro gives a turn `R_first_last` and, to first order, how the errors at the
first knot and the noise on the way reach the last one:

    d_last = E d_first + F rest_first + noise,   bias_last = bias_first + walk,

rest = bias, scale, misalignments, in the error state of `propagation`, whose closed-form steps are
chained here. The noise has the covariance [[Qaa, Qab], [Qab^T, qbb I]]: white noise and the bias's
walk, coupled. *Source*: Lupton & Sukkarieh 2012; Forster et al. 2017, with the bias's own walk
inside the interval kept, which they leave out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from geoposition.arrays import FloatArray, IntArray
from geoposition.rotation import quat_multiply
from geoposition.sensors.attitude_determination.propagation import (
    gyro_matrix,
    inverse3,
    process_noise,
    quat_of_turn,
    times_matrix,
    transition,
)
from geoposition.sensors.attitude_determination.threads import in_chunks
from geoposition.sensors.attitude_determination.timeline import Timeline

SIX = (0,) * 6
FIFTEEN = (0,) * 15
"""Tokens of the two gyro models: their length tells the compiler the number of states."""

MIN_STEP_S = 1e-9
"""Variance of a step no shorter than this: two heads may share a time but for rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """What joins k knots: `quat_xyzw` (k − 1, 4) of R_first_last, E, F, Qaa, Qab, qbb."""

    quat_xyzw: FloatArray
    E: FloatArray
    F: FloatArray
    Qaa: FloatArray
    Qab: FloatArray
    qbb: FloatArray


def preintegrate(
    timeline: Timeline,
    ends: IntArray,
    bias_rad_s: FloatArray,
    constants: FloatArray,
    general: bool,
    angle_random_walk: float,
    rate_random_walk: float,
) -> Links:
    """Chain the steps of a timeline between its knots `ends` (k,).

    The biases (k, 3) at those and the constants (9,) are as known so far. The state has 15
    entries for the `general` gyro model, else 6; F has as many columns but 3.
    """
    token = FIFTEEN if general else SIX
    n, wide = len(ends) - 1, len(token) - 3
    links = Links(
        np.empty((n, 4)),
        np.empty((n, 3, 3)),
        np.empty((n, 3, wide)),
        np.empty((n, 3, 3)),
        np.empty((n, 3, 3)),
        np.empty(n),
    )
    in_chunks(
        _preintegrate,
        n,
        token,
        timeline.turn_rad,
        timeline.step_s,
        timeline.extra_rad2,
        ends,
        bias_rad_s,
        constants,
        angle_random_walk**2,
        rate_random_walk**2,
        links.quat_xyzw,
        links.E,
        links.F,
        links.Qaa,
        links.Qab,
        links.qbb,
    )
    return links


@njit(cache=True, error_model="numpy")
def load_constants(bias: FloatArray, constants: FloatArray, rest: FloatArray) -> None:
    """Lay bias (3,) and constants (9,) out as `propagation` wants them: rest (12,)."""
    for i in range(3):
        rest[i] = bias[i]
    for i in range(9):
        rest[3 + i] = constants[i]


@njit(cache=True, error_model="numpy")
def start_link(
    quat: FloatArray, E: FloatArray, F: FloatArray, Qaa: FloatArray, Qab: FloatArray
) -> None:
    """Set the link over no time: no turn, no noise."""
    quat[:] = 0.0
    quat[3] = 1.0
    E[:, :] = 0.0
    E[0, 0] = E[1, 1] = E[2, 2] = 1.0
    F[:, :] = 0.0
    Qaa[:, :] = 0.0
    Qab[:, :] = 0.0


@njit(cache=True, error_model="numpy")
def extend_link(
    token: tuple[int, ...],
    angle: FloatArray,
    step: float,
    extra: float,
    bias: FloatArray,
    M: FloatArray,
    sv2: float,
    su2: float,
    quat: FloatArray,
    E: FloatArray,
    F: FloatArray,
    Qaa: FloatArray,
    Qab: FloatArray,
    qbb: float,
    A: FloatArray,
    B: FloatArray,
    work: FloatArray,
) -> float:
    """Append one step to a link in place; return its new qbb.

    A (3, 3) and B (3, n − 3) become the step's own transition; `work` (4, 3, 3) is scratch.
    """
    x, y, z = times_matrix(
        M, angle[0] - bias[0] * step, angle[1] - bias[1] * step, angle[2] - bias[2] * step
    )
    L2, Sdd, Sdb, T = work[0], work[1], work[2], work[3]
    factors = transition(token, x, y, z, step, M, A, B, L2)
    process_noise(token, x, y, z, max(step, MIN_STEP_S), sv2, su2, extra, factors, M, L2, Sdd, Sdb)
    a, b, c, d = quat_of_turn(x, y, z)
    a, b, c, d = quat_multiply(quat[0], quat[1], quat[2], quat[3], a, b, c, d)
    keep = 1.5 - 0.5 * (a * a + b * b + c * c + d * d)
    quat[0], quat[1], quat[2], quat[3] = keep * a, keep * b, keep * c, keep * d
    for j in range(3):
        a, b, c = E[0, j], E[1, j], E[2, j]
        for i in range(3):
            E[i, j] = A[i, 0] * a + A[i, 1] * b + A[i, 2] * c
    for j in range(len(token) - 3):
        a, b, c = F[0, j], F[1, j], F[2, j]
        for i in range(3):
            F[i, j] = A[i, 0] * a + A[i, 1] * b + A[i, 2] * c + B[i, j]
    # T = A Qaa + B_b Qab^T, then Qaa = T A^T + (A Qab + B_b qbb) B_b^T + Sdd
    for i in range(3):
        for j in range(3):
            s = 0.0
            for k in range(3):
                s += A[i, k] * Qaa[k, j] + B[i, k] * Qab[j, k]
            T[i, j] = s
    for j in range(3):
        a, b, c = Qab[0, j], Qab[1, j], Qab[2, j]
        for i in range(3):
            Qab[i, j] = A[i, 0] * a + A[i, 1] * b + A[i, 2] * c + B[i, j] * qbb
    for i in range(3):
        for j in range(3):
            s = Sdd[i, j]
            for k in range(3):
                s += T[i, k] * A[j, k] + Qab[i, k] * B[j, k]
            Qaa[i, j] = s
    for i in range(3):
        for j in range(3):
            Qab[i, j] += Sdb[i, j]
    return qbb + su2 * max(step, MIN_STEP_S)


@njit(cache=True, error_model="numpy")
def _preintegrate_link(
    i: int,
    token: tuple[int, ...],
    angle: FloatArray,
    step: FloatArray,
    extra: FloatArray,
    first: IntArray,
    bias: FloatArray,
    constants: FloatArray,
    sv2: float,
    su2: float,
    quat: FloatArray,
    E: FloatArray,
    F: FloatArray,
    Qaa: FloatArray,
    Qab: FloatArray,
    qbb: FloatArray,
) -> None:
    """Chain the steps between knots i and i + 1."""
    rest, gyro, M = np.empty(12), np.empty((3, 3)), np.empty((3, 3))
    A, B, work = np.empty((3, 3)), np.empty((3, len(token) - 3)), np.empty((4, 3, 3))
    load_constants(bias[i], constants, rest)
    gyro_matrix(rest, gyro)
    inverse3(gyro, M)
    start_link(quat[i], E[i], F[i], Qaa[i], Qab[i])
    total = 0.0
    for k in range(first[i], first[i + 1]):
        total = extend_link(
            token,
            angle[k],
            step[k],
            extra[k],
            bias[i],
            M,
            sv2,
            su2,
            quat[i],
            E[i],
            F[i],
            Qaa[i],
            Qab[i],
            total,
            A,
            B,
            work,
        )
    qbb[i] = total


@njit(cache=True, error_model="numpy", nogil=True)
def _preintegrate(
    low: int,
    high: int,
    token: tuple[int, ...],
    angle: FloatArray,
    step: FloatArray,
    extra: FloatArray,
    first: IntArray,
    bias: FloatArray,
    constants: FloatArray,
    sv2: float,
    su2: float,
    quat: FloatArray,
    E: FloatArray,
    F: FloatArray,
    Qaa: FloatArray,
    Qab: FloatArray,
    qbb: FloatArray,
) -> None:
    for i in range(low, high):
        _preintegrate_link(
            i,
            token,
            angle,
            step,
            extra,
            first,
            bias,
            constants,
            sv2,
            su2,
            quat,
            E,
            F,
            Qaa,
            Qab,
            qbb,
        )
