"""Statements of P that a rigorous model can check: what a shaking body does to an image.

P section 1: 0.36 arcsec of unmodelled jitter from 500 km are 0.4 px at 3 m and 4 to 5 px at
0.3 m. P section 3: only a body steady to 1/100 px keeps an image true to one pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.simulate import (
    ARCSEC_RAD,
    CameraDesign,
    SceneOptions,
    simulate_scene,
)

JITTER_ARCSEC: Final = 0.36
JITTER_HZ: Final = 1.0
PAPER_PX: Final = {3.0: "0.4", 0.3: "4–5"}
STEADY_PX: Final = 0.01
FAST_HZ: Final = 200.0
SCENE_LINES: Final = 30_000
"""Of P's scenes."""

_PITCH_M: Final = 10e-6
_GROUND_SPEED_M_S: Final = 7060.0
_PAD_S: Final = 0.6
_KNOTS_PER_PERIOD: Final = 24
_WALK_LINES: Final = 20
_PROBES: Final = 2001


@dataclass(frozen=True, slots=True)
class Claim:
    """One case: `paper` as stated; largest shift and, a plane taken off, its RMS, pixels."""

    what: str
    altitude_km: float
    gsd_m: float
    axes: str
    paper: str
    closed_form_px: float
    largest_px: float
    internal_px: float


def unmodelled_jitter() -> list[Claim]:
    """P section 1, for one axis and for roll and pitch together."""
    rows = []
    for gsd in PAPER_PX:
        believed = _image(500e3, gsd, round(2.0 * _GROUND_SPEED_M_S / gsd / JITTER_HZ))
        times = _knots(believed, 1.0 / (_KNOTS_PER_PERIOD * JITTER_HZ))
        for axes in ("pitch", "roll and pitch"):
            turn = np.zeros((len(times), 3))
            wave = JITTER_ARCSEC * ARCSEC_RAD * np.sin(2.0 * np.pi * JITTER_HZ * times)
            turn[:, 1] = wave
            if axes != "pitch":
                turn[:, 0] = wave
            expected = (
                JITTER_ARCSEC * ARCSEC_RAD * 500e3 / gsd * (1.0 if axes == "pitch" else 2**0.5)
            )
            rows.append(
                _claim(
                    f"{JITTER_ARCSEC}″ at {JITTER_HZ:g} Hz, {gsd:g} m", 500.0, gsd, axes,
                    f"{PAPER_PX[gsd]} px", expected, _shift_px(believed, times, turn),
                )
            )  # fmt: skip
    return rows


def steadiness(seed: int) -> list[Claim]:
    """P's rule of 1/100 px, read as a fast oscillation and as a walk from line to line."""
    gsd, altitude = 0.5, 490e3
    believed = _image(altitude, gsd, SCENE_LINES)
    step_rad = STEADY_PX * gsd / altitude
    times = _knots(believed, 1.0 / (_KNOTS_PER_PERIOD * FAST_HZ))
    fast = np.zeros((len(times), 3))
    fast[:, :2] = step_rad * np.sin(2.0 * np.pi * FAST_HZ * times)[:, None]
    line_s = gsd / _GROUND_SPEED_M_S
    coarse = _knots(believed, _WALK_LINES * line_s)
    walk = np.zeros((len(coarse), 3))
    rng = np.random.default_rng([seed, 4])
    walk[:, :2] = (
        step_rad * np.sqrt(_WALK_LINES) * np.cumsum(rng.standard_normal((len(coarse), 2)), axis=0)
    )
    both = 2**0.5
    return [
        _claim(
            f"{STEADY_PX} px at {FAST_HZ:g} Hz", altitude / 1e3, gsd, "roll and pitch",
            "below 1 px", both * STEADY_PX, _shift_px(believed, times, fast),
        ),
        _claim(
            f"{STEADY_PX} px more, at random, each line", altitude / 1e3, gsd, "roll and pitch",
            "below 1 px", both * STEADY_PX * np.sqrt(SCENE_LINES),
            _shift_px(believed, coarse, walk),
        ),
    ]  # fmt: skip


def _image(altitude_m: float, gsd_m: float, lines: int) -> PushbroomModel:
    """Nadir image of a still body above the equator, of square pixels."""
    design = CameraDesign(
        "nadir", 0.0, _PITCH_M * altitude_m / gsd_m, _PITCH_M, 1, 1000, lines,
        round(gsd_m / _GROUND_SPEED_M_S, 9), (), (0.0,), (0.0,),
    )  # fmt: skip
    still = SceneOptions(
        lon_deg=113.0,
        lat_deg=0.0,
        height_range_m=(-100.0, 100.0),
        altitude_m=altitude_m,
        jitter_arcsec=(0.0, 0.0, 0.0),
        drift_arcsec=0.0,
        gps_sigma_m=0.0,
        mounting_bias_arcsec=0.0,
    )
    return simulate_scene(still, 0, (design,)).true["nadir"]


def _knots(model: PushbroomModel, step_s: float) -> FloatArray:
    ends = np.sort(model.camera.timing.time_s(np.array([0.0, model.shape[0] - 1.0])))
    pad = _PAD_S + 0.05 * float(ends[1] - ends[0])
    return np.arange(ends[0] - pad, ends[1] + pad, step_s)


def _shift_px(believed: PushbroomModel, times_s: FloatArray, turn_rad: FloatArray) -> FloatArray:
    """How far (n, 2) pixels lie from where the unshaken model expects them, line by line."""
    calm = believed.attitude
    shaken = calm.rotation(times_s) * Rotation.from_rotvec(turn_rad)
    true = replace(
        believed,
        attitude=Attitude.from_samples(calm.epoch, times_s, shaken.as_quat(), "itrs", "spline"),
    )
    lines, samples = believed.shape
    image = np.column_stack(
        [np.linspace(0.0, lines - 1.0, _PROBES), np.full(_PROBES, 0.5 * (samples - 1.0))]
    )
    ground = true.image_to_ground(image, 0.0).geodetic
    return np.asarray(believed.ground_to_image(ground).image_px - image)


def _claim(
    what: str,
    altitude_km: float,
    gsd_m: float,
    axes: str,
    paper: str,
    closed_form_px: float,
    shift_px: FloatArray,
) -> Claim:
    line = np.linspace(-1.0, 1.0, len(shift_px))
    plane = np.column_stack([np.ones_like(line), line])
    rest = shift_px - plane @ np.linalg.lstsq(plane, shift_px, rcond=None)[0]
    return Claim(
        what,
        altitude_km,
        gsd_m,
        axes,
        paper,
        float(closed_form_px),
        float(np.max(np.hypot(shift_px[:, 0], shift_px[:, 1]))),
        float(np.sqrt(np.mean(np.sum(rest**2, axis=1)))),
    )
