"""Do the intervals of accuracy reports hold the truth? Simulated matches, evaluated as any other.

Each run draws a scene's errors anew (a shift, a tilt, cubic bows, a vibration), the matching's
noise, which patches are lost and how large they are said to be wrong, then evaluates; the truth
is what the same numbers are without noise. The relative numbers' truth V is 0 by definition.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from geoposition.accuracy import circular_error_m, enu_errors_m
from geoposition.arrays import FloatArray
from geoposition.calib_fields.evaluate import KEYS, evaluate
from geoposition.calib_fields.matches import Cause, DomMatches
from geoposition.errors import ArgumentError
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.simulate import CameraDesign, simulate_scene

_SHAPE: Final = (4000, 2000)
_WINDOW_PX: Final = 64
_FOCAL_M, _PITCH_M, _ALTITUDE_M = 1.7, 7e-6, 506e3
_LEAST: Final = 0.93


@dataclass(frozen=True, slots=True)
class IntervalCoverage:
    """How many of `runs` intervals of 95 % held the truth, by number, and pooled."""

    runs: int
    held: Mapping[str, int]

    @property
    def pooled(self) -> float:
        """Share of all intervals of all runs."""
        return sum(self.held.values()) / (self.runs * len(self.held))

    def as_json(self) -> dict[str, Any]:
        """Return the shares, and the sentence they make."""
        rows = [
            {"number": name, "held": count / self.runs, "runs": self.runs}
            for name, count in self.held.items()
        ]
        rows.append({"number": "all, pooled", "held": self.pooled, "runs": self.runs})
        verdict = "hold" if self.pooled >= _LEAST else "do not hold"
        return {
            "runs": self.runs,
            "coverage": {name: count / self.runs for name, count in self.held.items()},
            "pooled": self.pooled,
            "tables": {"coverage of stated 95 % intervals": rows},
            "finding": (
                f"Intervals of 95 %, pooled over {len(self.held)} numbers and {self.runs} runs, "
                f"hold the truth in {100.0 * self.pooled:.1f} %: they {verdict} the promised "
                f"{100.0 * _LEAST:.0f} %."
            ),
        }


def run(
    runs: int, *, seed: int = 0, progress: Callable[[int, int], None] | None = None
) -> IntervalCoverage:
    """Draw, evaluate and count `runs` scenes."""
    if runs < 1:
        raise ArgumentError(f"intervals: one run or more expected, got {runs}")
    model = believed_model()
    held = dict.fromkeys(KEYS, 0)
    for k, stream in enumerate(np.random.SeedSequence(seed).spawn(runs)):
        matches, truth = drawn_matches(model, np.random.default_rng(stream))
        found = evaluate(matches, model).estimates
        for name in KEYS:
            low, high = found[name].interval
            held[name] += low <= truth[name] <= high
        if progress is not None:
            progress(k + 1, runs)
    return IntervalCoverage(runs, held)


def believed_model() -> PushbroomModel:
    """Model of a nadir scene of 2 m pixels."""
    lines, samples = _SHAPE
    design = CameraDesign("nadir", 0.0, _FOCAL_M, _PITCH_M, 1, samples, lines, 3e-4)
    return simulate_scene(cameras=(design,)).true["nadir"]


def drawn_matches(
    model: PushbroomModel, rng: np.random.Generator
) -> tuple[DomMatches, dict[str, float]]:
    """Draw matches of a scene of random errors, and the numbers these have without noise."""
    spacing = int(rng.choice([48, 64, 96]))
    first = 0.5 * _WINDOW_PX
    place = np.stack(
        np.meshgrid(*(np.arange(first, n - first, spacing) for n in _SHAPE), indexing="ij"),
        axis=-1,
    ).reshape(-1, 2)
    place = place[rng.random(len(place)) < rng.uniform(0.3, 1.0)]
    truth = _errors(place, rng)
    noise_px = float(rng.choice([0.02, 0.05, 0.15]))
    ground = model.image_to_ground(place, 400.0).geodetic
    observed = place + truth + noise_px * rng.standard_normal(truth.shape)

    def shift(image_px: FloatArray) -> FloatArray:
        located = model.image_to_ground(image_px, ground[:, 2]).geodetic
        result: FloatArray = -enu_errors_m(located, ground)[:, :2]
        return result

    sample_m = _ALTITUDE_M * _PITCH_M / _FOCAL_M
    stated_px = noise_px * float(np.exp(0.15 * rng.standard_normal()))
    one = np.broadcast_to(np.eye(2), (len(place), 2, 2))
    matches = DomMatches(
        ground=ground,
        model_px=place,
        image_px=observed,
        covariance_px2=stated_px**2 * one,
        shift_en_m=shift(observed),
        covariance_m2=(stated_px * sample_m) ** 2 * one,
        correlation=np.full(len(place), 0.9),
        cause=np.full(len(place), Cause.USED, dtype=np.uint8),
        pixel_m=sample_m,
        ground_sample_m=(sample_m, sample_m),
        window_px=_WINDOW_PX,
        spacing_px=spacing,
        lines_per_pixel=(1.0, 0.0),
    )
    return matches, _numbers(truth, shift(place + truth))


def _errors(place: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Error (n, 2) of the image: shift, tilt, bows over sample and line, a vibration."""
    u = place / np.array(_SHAPE) * 2.0 - 1.0
    error = rng.uniform(-2.0, 2.0, 2) * np.ones((len(place), 1))
    error = error + rng.uniform(-1.5, 1.5, 2) * u[:, 1:] ** 3 + rng.uniform(-0.5, 0.5, 2) * u
    error = error + rng.uniform(-0.5, 0.5, 2) * u[:, :1] ** 2
    phase = 2.0 * np.pi * (place[:, :1] / rng.uniform(250.0, 1500.0) + rng.uniform())
    result: FloatArray = error + rng.uniform(0.0, 0.4, 2) * np.sin(phase)
    return result


def _numbers(error: FloatArray, shift: FloatArray) -> dict[str, float]:
    m_x, m_y = np.sqrt(np.mean((error - error.mean(axis=0)) ** 2, axis=0))
    rmse = np.sqrt(np.mean(shift**2, axis=0))
    return {
        "bias_e_m": float(shift[:, 0].mean()),
        "bias_n_m": float(shift[:, 1].mean()),
        "rmse_e_m": float(rmse[0]),
        "rmse_n_m": float(rmse[1]),
        "ce90_m": circular_error_m(shift),
        "relative_px": float(np.hypot(m_x, m_y)),
        "v_x": 0.0,
        "v_y": 0.0,
        "m_x": float(m_x),
        "m_y": float(m_y),
    }
