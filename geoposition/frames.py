"""Inertial and Earth-fixed frames: GCRS, mean equator of J2000 and ITRS.

The only door to pyerfa's models. The chain is the CIO-based one,
    R_itrs_gcrs = W(xp, yp, s') R3(ERA(UT1)) Q(X + dX, Y + dY, s),
with X, Y, s of IAU 2006 precession and 2000A nutation, and the Earth's orientation of
`earth_orientation`: the IERS tables by default, which refuse times outside their span.
ITRS, ECEF and WGS 84 are one here: the WGS 84 realisations follow ITRF to 2 cm.

"J2000" in product files mostly means GCRS (star catalogues are ICRS); where it really means the
mean equator and equinox of J2000 (EME2000), `R_eme2000_gcrs` is the constant bias between them,
0.023 arcseconds (0.06 m at the ground from 500 km, 0.8 m as a position at LEO).

Source: IERS Conventions (2010), chapter 5, (5.1)–(5.15); SOFA, Tools for Earth Attitude.
"""

from __future__ import annotations

from typing import Final

import erfa
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, as_components
from geoposition.earth_orientation import EarthOrientation, OrientationTable, OrientationValues
from geoposition.errors import ArgumentError
from geoposition.leap_seconds import DAY_S
from geoposition.timescale import Epoch

ERA_RATE_RAD_S: Final = 2.0 * np.pi * 1.00273781191135448 / DAY_S
"""Rate of the Earth rotation angle per second of UT1, IERS Conventions (2010), (5.15)."""

_NODE_STEP_S: Final = 3600.0
_RATE_STEP_S: Final = 600.0


def matrix_itrs_gcrs(
    epoch: Epoch, times_s: ArrayLike, orientation: EarthOrientation | None = None
) -> FloatArray:
    """Matrices (..., 3, 3) from GCRS to ITRS at `times_s` (...) seconds after `epoch`.

    `orientation` None is the shipped IERS table; times outside it are an
    `EarthOrientationError`.
    """
    times = _times(times_s)
    values = _orientation(orientation).at(epoch, times)
    return _terrestrial(epoch, times, values) @ _celestial_matrix(epoch, times, values)


def R_itrs_gcrs(
    epoch: Epoch, times_s: ArrayLike, orientation: EarthOrientation | None = None
) -> Rotation:
    """`matrix_itrs_gcrs` as rotations (...): GCRS components to ITRS components."""
    return Rotation.from_matrix(matrix_itrs_gcrs(epoch, times_s, orientation), assume_valid=True)


def R_eme2000_gcrs() -> Rotation:
    """Frame bias: GCRS components to those on the mean equator and equinox of J2000.

    *Source*: IERS Conventions (2010), (5.33); IAU 2000 values.
    """
    bias, _, _ = erfa.bp00(erfa.DJ00, 0.0)
    return Rotation.from_matrix(bias)


def earth_rate_itrs(
    epoch: Epoch, times_s: ArrayLike, orientation: EarthOrientation | None = None
) -> FloatArray:
    """Angular velocity (..., 3) of ITRS against GCRS, in ITRS axes, rad/s.

    The Earth's spin with the length of day and the pole, and precession-nutation (7.7e-12
    rad/s). The drift of the pole itself, below 3e-13 rad/s (2 µm/s at LEO), is left out.
    """
    times = _times(times_s)
    return _earth_rate(epoch, times, _orientation(orientation).at(epoch, times))


def itrs_from_gcrs(
    position_gcrs_m: ArrayLike,
    velocity_gcrs_m_s: ArrayLike,
    epoch: Epoch,
    times_s: ArrayLike,
    orientation: EarthOrientation | None = None,
) -> tuple[FloatArray, FloatArray]:
    """ITRS positions (..., 3) and velocities relative to the rotating Earth (..., 3).

    *Source*: v_itrs = R v_gcrs − omega × r_itrs.
    """
    position, velocity, times = _series(position_gcrs_m, velocity_gcrs_m_s, times_s)
    matrix, rate = _matrix_and_rate(epoch, times, orientation)
    position_itrs = _turn(matrix, position)
    return position_itrs, _turn(matrix, velocity) - np.cross(rate, position_itrs)


def gcrs_from_itrs(
    position_itrs_m: ArrayLike,
    velocity_itrs_m_s: ArrayLike,
    epoch: Epoch,
    times_s: ArrayLike,
    orientation: EarthOrientation | None = None,
) -> tuple[FloatArray, FloatArray]:
    """GCRS positions and inertial velocities (..., 3) of Earth-fixed ones; the inverse."""
    position, velocity, times = _series(position_itrs_m, velocity_itrs_m_s, times_s)
    matrix, rate = _matrix_and_rate(epoch, times, orientation)
    inverse = np.swapaxes(matrix, -1, -2)
    return _turn(inverse, position), _turn(inverse, velocity + np.cross(rate, position))


def R_itrs_body(
    R_gcrs_body: Rotation,
    epoch: Epoch,
    times_s: ArrayLike,
    orientation: EarthOrientation | None = None,
) -> Rotation:
    """Earth-fixed attitude at `times_s` (...) from the inertial one: R_itrs_gcrs R_gcrs_body."""
    return R_itrs_gcrs(epoch, times_s, orientation) * R_gcrs_body


def R_gcrs_body(
    R_itrs_body: Rotation,
    epoch: Epoch,
    times_s: ArrayLike,
    orientation: EarthOrientation | None = None,
) -> Rotation:
    """Inertial attitude at `times_s` (...) from the Earth-fixed one; inverse of `R_itrs_body`."""
    return R_itrs_gcrs(epoch, times_s, orientation).inv() * R_itrs_body


# The parts of the chain ---------------------------------------------------------------------


def _times(times_s: ArrayLike) -> FloatArray:
    times = np.asarray(times_s, dtype=np.float64)
    if not np.all(np.isfinite(times)):
        raise ArgumentError("times_s: finite seconds expected")
    return times


def _series(
    position_m: ArrayLike, velocity_m_s: ArrayLike, times_s: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    position = as_components(position_m, 3, "position")
    velocity = as_components(velocity_m_s, 3, "velocity")
    times = _times(times_s)
    try:
        np.broadcast_shapes(position.shape[:-1], velocity.shape[:-1], times.shape)
    except ValueError:
        raise ArgumentError(
            f"one position and velocity per time expected, got {position.shape}, "
            f"{velocity.shape} and {times.shape}"
        ) from None
    return position, velocity, times


def _orientation(orientation: EarthOrientation | None) -> EarthOrientation:
    return OrientationTable.shipped() if orientation is None else orientation


def _turn(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _matrix_and_rate(
    epoch: Epoch, times: FloatArray, orientation: EarthOrientation | None
) -> tuple[FloatArray, FloatArray]:
    values = _orientation(orientation).at(epoch, times)
    matrix = _terrestrial(epoch, times, values) @ _celestial_matrix(epoch, times, values)
    return matrix, _earth_rate(epoch, times, values)


def _terrestrial(epoch: Epoch, times: FloatArray, values: OrientationValues) -> FloatArray:
    """Matrices W(xp, yp, s') R3(ERA) from the celestial intermediate frame to ITRS."""
    jd_day, jd_tai = epoch.jd_tai()
    era = erfa.era00(jd_day, jd_tai + (times + values.ut1_minus_tai_s) / DAY_S)
    matrix = _pole_matrix(epoch, times, values)
    # W R3(era): two columns turn, the third stays
    cos, sin = np.cos(era)[..., None], np.sin(era)[..., None]
    first, second = matrix[..., 0].copy(), matrix[..., 1].copy()
    matrix[..., 0] = first * cos - second * sin
    matrix[..., 1] = first * sin + second * cos
    return matrix


def _pole_matrix(epoch: Epoch, times: FloatArray, values: OrientationValues) -> FloatArray:
    jd_day, jd_tt = epoch.jd_tt()
    s_prime = erfa.sp00(jd_day, jd_tt + times / DAY_S)
    return np.array(erfa.pom00(values.xp_rad, values.yp_rad, s_prime), dtype=np.float64)


def _celestial_matrix(epoch: Epoch, times: FloatArray, values: OrientationValues) -> FloatArray:
    """Matrices Q from GCRS to the celestial intermediate frame."""
    x, y, s = np.moveaxis(_celestial_pole(epoch, times), -1, 0)
    return np.asarray(erfa.c2ixys(x + values.dx_rad, y + values.dy_rad, s))


def _celestial_pole(epoch: Epoch, times: FloatArray) -> FloatArray:
    """X, Y, s (..., 3) of IAU 2006/2000A in radians.

    The series has over 4,000 terms: it is summed at hourly nodes, with cubics between, wherever
    that takes fewer sums. Its shortest strong terms have days, so this costs below 1e-14 rad.
    """
    if times.size == 0:
        return np.empty((*times.shape, 3))
    jd_day, jd_tt = epoch.jd_tt()
    first = np.floor(np.min(times) / _NODE_STEP_S) - 1.0
    last = np.floor(np.max(times) / _NODE_STEP_S) + 2.0
    if last - first + 1.0 >= times.size:
        return np.stack(erfa.xys06a(jd_day, jd_tt + times / DAY_S), axis=-1)
    nodes_s = np.arange(first, last + 1.0) * _NODE_STEP_S
    xys = np.stack(erfa.xys06a(jd_day, jd_tt + nodes_s / DAY_S), axis=-1)
    place = times / _NODE_STEP_S - first
    left = np.clip(np.floor(place).astype(np.intp), 1, len(nodes_s) - 3)
    u = (place - left)[..., None]
    return np.asarray(
        xys[left - 1] * (-u * (u - 1.0) * (u - 2.0) / 6.0)
        + xys[left] * ((u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0)
        + xys[left + 1] * (-(u + 1.0) * u * (u - 2.0) / 2.0)
        + xys[left + 2] * ((u + 1.0) * u * (u - 1.0) / 6.0)
    )


def _earth_rate(epoch: Epoch, times: FloatArray, values: OrientationValues) -> FloatArray:
    spin = ERA_RATE_RAD_S * (1.0 + values.ut1_rate)
    rate = _pole_matrix(epoch, times, values)[..., 2] * spin[..., None]
    # Precession-nutation turns Q by a nearly constant small rate: a central difference.
    before = erfa.c2ixys(*np.moveaxis(_celestial_pole(epoch, times - _RATE_STEP_S), -1, 0))
    after = erfa.c2ixys(*np.moveaxis(_celestial_pole(epoch, times + _RATE_STEP_S), -1, 0))
    turn = after @ np.swapaxes(before, -1, -2)  # 1 − [angle]×, angle of the frame itself
    angle = 0.5 * np.stack(
        [
            turn[..., 1, 2] - turn[..., 2, 1],
            turn[..., 2, 0] - turn[..., 0, 2],
            turn[..., 0, 1] - turn[..., 1, 0],
        ],
        axis=-1,
    )
    drift = angle / (2.0 * _RATE_STEP_S)
    return np.asarray(rate + _turn(_terrestrial(epoch, times, values), drift))
