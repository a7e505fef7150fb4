"""Synthetic push-broom images from one orbit that all look at one place; for tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scenes

from geoposition.arrays import FloatArray
from geoposition.constants import GM_M3_S2
from geoposition.pushbroom import PushbroomModel

ORBIT = scenes.Orbit.over(0.2, 0.75)
RATE_RAD_S = float(np.sqrt(GM_M3_S2 / ORBIT.semi_major_m**3))


def along(seconds: float, pitch_deg: float, shape: tuple[int, int]) -> PushbroomModel:
    """Image taken `seconds` later along the orbit, pitched by so much."""
    orbit = replace(ORBIT, anomaly_rad=ORBIT.anomaly_rad + RATE_RAD_S * seconds)
    return scenes.build(shape, pitch_deg=pitch_deg, orbit=orbit).model()


def views(
    seconds: tuple[float, ...], shape: tuple[int, int] = (2000, 1500), height_m: float = 500.0
) -> list[PushbroomModel]:
    """Images whose middles all see the place straight below t = 0."""
    middle = 0.5 * (np.array(shape) - 1.0)
    centre = along(0.0, 0.0, shape).image_to_ground(middle, height_m).geodetic
    return [_looking_at(centre, s, shape, middle) for s in seconds]


def _looking_at(
    centre: FloatArray, seconds: float, shape: tuple[int, int], middle: FloatArray
) -> PushbroomModel:
    pitch, step = 0.65 * seconds, 1e-3
    for _ in range(7):
        seen, moved = (
            along(seconds, p, shape).image_to_ground(middle, centre[2]).geodetic[:2]
            for p in (pitch, pitch + step)
        )
        slope = (moved - seen) / step
        pitch += float(slope @ (centre[:2] - seen) / (slope @ slope))
    return along(seconds, pitch, shape)
