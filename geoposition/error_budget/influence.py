"""How errors of attitude, orbit, time and height move a located ground point (T 2.9–2.14).

The line of sight of a pixel, S + range u, is turned by a small d or moved with S, and meets the
surface of constant height, whose normal is n, again:
    dP = (1 − u nᵀ / (n · u)) (range d × u + d × arm + dS) .
The oblique projection is the re-intersection. T (2.9)–(2.11) turn about ECEF X, and T (2.11)
keeps the scale, hence the range, which leaves the ground; with the derivative of T (2.14),
d(R p)/d d = −(R p)×, and the projection both are mended, about any axes.

Aberration and light time shift the direction seen on board, which is what turns, by f = v / c:
d turns u + f / k, k = |u_app − f|. Refraction changes with the zenith angle. Both together are
some 20 m a radian: 3e-5 of a roll, yet as much as a turn about the line of sight itself does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FlagArray, FloatArray
from geoposition.constants import EARTH_RATE_RAD_S, SPEED_OF_LIGHT_M_S
from geoposition.ellipsoid import enu_axes, geodetic_to_ecef
from geoposition.errors import ArgumentError
from geoposition.orbit_frame import inertial_velocity_ecef, zenith_orbit_axes
from geoposition.pushbroom import PushbroomModel
from geoposition.rotation import skew

ARCSEC_RAD: Final = np.pi / (180.0 * 3600.0)
_MEAN_RADIUS_M: Final = 6371e3
_HALF_STEP_S: Final = 5e-4
"""Rates are secants over a millisecond: attitude between its samples may have kinks."""


@dataclass(frozen=True, slots=True, eq=False)
class Influence:
    """Movements of ground points (n) at constant ellipsoidal height, in ECEF.

    `turn_body_m` and `turn_orbit_m` (n, 3, 3): metres per radian of a turn of the satellite
    about its body axes x, y, z (R exp(d)), and about the orbit's axes: along track, left, up
    (the zenith frame of `orbit_frame`). `position_m` (n, 3, 3): metres per metre of the
    satellite's position along the same orbit axes. `time_m` (n, 3): metres per second by which
    a line was really taken later than the model says. `height_m` (n, 3): metres per metre that
    the surface lies higher. The columns are the axes. `geodetic` (n, 3) are the ground points,
    `R_ecef_orbit` (n, 3, 3) the orbit's axes; NaN where `flag` (n,) has no result.
    """

    geodetic: FloatArray
    turn_body_m: FloatArray
    turn_orbit_m: FloatArray
    position_m: FloatArray
    time_m: FloatArray
    height_m: FloatArray
    R_ecef_orbit: FloatArray
    flag: FlagArray


def influence(model: PushbroomModel, image_px: ArrayLike, height_m: ArrayLike) -> Influence:
    """Influence of the errors of `model` at `image_px` (n, 2) on the surface `height_m` (n,).

    An `ArgumentError` where the model is not a rigorous one.
    """
    if not isinstance(model, PushbroomModel):
        raise ArgumentError("error influence: a rigorous model expected; this one has no orbit")
    image = np.atleast_2d(np.asarray(image_px, dtype=np.float64))
    height = np.broadcast_to(np.asarray(height_m, dtype=np.float64), (len(image),))
    located = model.image_to_ground(image, height)
    rays = model.rays(image, height)
    up = enu_axes(located.geodetic)[:, :, 2]
    bend = _bend_m(model, located.geodetic[:, 2])
    # Without refraction the line of sight would meet the surface here.
    ground = geodetic_to_ecef(located.geodetic) - _shift(bend, rays.direction_ecef, up)
    reach = np.linalg.norm(ground - rays.origin_ecef_m, axis=1)
    u = (ground - rays.origin_ecef_m) / reach[:, None]
    slant = u / np.einsum("ni,ni->n", u, up)[:, None]
    onto = np.eye(3) - slant[:, :, None] * up[:, None, :]

    motion = _motion(model, image[:, 0])
    arm = motion.R_ecef_body @ np.asarray(model.camera.lever_arm_body_m, dtype=np.float64)
    seen = u + _aberration(model, motion, ground, u)
    du = -skew(seen)
    turn = onto @ (reach[:, None, None] * du - skew(arm))
    turn += _shift_change(bend, u, up, du, turn)
    orbit = zenith_orbit_axes(motion.position_m, motion.inertial_m_s)
    moved = motion.velocity_m_s + np.cross(motion.rate_rad_s, reach[:, None] * seen + arm)
    return Influence(
        geodetic=located.geodetic,
        turn_body_m=turn @ motion.R_ecef_body,
        turn_orbit_m=turn @ orbit,
        position_m=onto @ orbit,
        time_m=np.einsum("nij,nj->ni", onto, moved),
        height_m=slant,
        R_ecef_orbit=orbit,
        flag=located.flag,
    )


def _aberration(
    model: PushbroomModel, motion: _Motion, ground: FloatArray, u: FloatArray
) -> FloatArray:
    """Apparent less true direction (n, 3) over k: f / k, see `corrections`."""
    corrections = model.corrections
    f = np.zeros_like(u)
    if corrections.velocity_aberration:
        f += motion.inertial_m_s
    if corrections.light_time:
        f -= np.cross([0.0, 0.0, EARTH_RATE_RAD_S], ground)
    f /= SPEED_OF_LIGHT_M_S
    along = np.einsum("ni,ni->n", u, f)
    k = np.sqrt(1.0 - np.einsum("ni,ni->n", f, f) + along**2) - along
    return np.asarray(f / k[:, None], dtype=np.float64)


def _bend_m(model: PushbroomModel, height_m: FloatArray) -> FloatArray:
    """K (n,) of the shift by refraction, metres; see `corrections`."""
    refraction = model.corrections.refraction
    if refraction is None:
        return np.zeros(len(height_m))
    size = refraction.refractivity * refraction.scale_height_m
    return np.asarray(size * np.exp(-height_m / refraction.scale_height_m), dtype=np.float64)


def _shift(bend_m: FloatArray, u: FloatArray, up: FloatArray) -> FloatArray:
    """Shift by refraction (n, 3), K (−u − c n) / c³ with c = −n · u."""
    c = -np.einsum("ni,ni->n", u, up)[:, None]
    return np.asarray(bend_m[:, None] * (-u - c * up) / c**3, dtype=np.float64)


def _shift_change(
    bend_m: FloatArray, u: FloatArray, up: FloatArray, du: FloatArray, moved: FloatArray
) -> FloatArray:
    """Differentiate the shift by refraction: (n, 3, 3).

    `du` (n, 3, 3) is the derivative of the direction, `moved` that of the ground point, whose
    vertical turns with it.
    """
    c = -np.einsum("ni,ni->n", u, up)[:, None, None]
    # An aberrated direction turns about its own axis too: only what lies across u counts.
    du = du - u[:, :, None] * np.einsum("ni,nij->nj", u, du)[:, None, :]
    dn = moved / _MEAN_RADIUS_M
    dc = -np.einsum("ni,nij->nj", up, du) - np.einsum("ni,nij->nj", u, dn)
    dc = dc[:, None, :]
    flat = -u[:, :, None] - c * up[:, :, None]
    change = (-du - dc * up[:, :, None] - c * dn) / c**3 - 3.0 * flat * dc / c**4
    return np.asarray(bend_m[:, None, None] * change, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """Pose (n) and its rates, Earth-fixed: position, velocity, attitude, angular rate in ECEF."""

    position_m: FloatArray
    velocity_m_s: FloatArray
    inertial_m_s: FloatArray
    R_ecef_body: FloatArray
    rate_rad_s: FloatArray


def _motion(model: PushbroomModel, line: FloatArray) -> _Motion:
    timing, ephemeris, attitude = model.camera.timing, model.ephemeris, model.attitude
    covered = np.clip(np.nan_to_num(line), *model.covered_lines)
    time = timing.time_s(covered)
    at = _inside(time + (timing.epoch - ephemeris.epoch), ephemeris.span_s)
    position, velocity = ephemeris.position_m(at), ephemeris.velocity_m_s(at)
    turned = time + (timing.epoch - attitude.epoch)
    before = _inside(turned - _HALF_STEP_S, attitude.span_s)
    after = _inside(turned + _HALF_STEP_S, attitude.span_s)
    now = attitude.rotation(_inside(turned, attitude.span_s))
    change: Rotation = attitude.rotation(after) * attitude.rotation(before).inv()
    return _Motion(
        position,
        velocity,
        inertial_velocity_ecef(position, velocity),
        now.as_matrix(),
        change.as_rotvec() / (after - before)[:, None],
    )


def _inside(times_s: FloatArray, span_s: tuple[float, float]) -> FloatArray:
    """Put times that rounding or half a step takes outside the span back at its end."""
    return np.clip(times_s, *span_s)
