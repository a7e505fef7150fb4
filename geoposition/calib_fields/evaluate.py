"""Accuracy of an image from its matches with a reference: absolute and relative, with intervals.

Axes as P (9): x along the track (line), y across it (sample). All sizes are those of the image's
error: the variance that the matching states for itself is taken out of mean squares, and its own
uncertainty put into the intervals. The reference's accuracy, a constant error of unknown size and
direction as far as one scene shows, widens the intervals of the absolute numbers alone.

*Source*: P tables 1 and 2 for the relative numbers; the relative accuracy is hypot(Mx, My).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from geoposition.arrays import FloatArray, IntArray
from geoposition.calib_fields.estimates import (
    LEAST_POINTS,
    absolute_errors,
    chess_board,
    held_out_mean,
    matching_noise,
    relative_errors,
)
from geoposition.calib_fields.evaluation import (
    KEYS,
    CcdError,
    Evaluation,
    EvaluationOptions,
)
from geoposition.calib_fields.intervals import Cells
from geoposition.calib_fields.matches import DomMatches
from geoposition.calib_fields.profiles import ResidualSpectrum, profile, residual_spectrum
from geoposition.calib_fields.relative import fitted, relative_terms
from geoposition.errors import GeometryError
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel

__all__ = [
    "KEYS",
    "CcdError",
    "Evaluation",
    "EvaluationOptions",
    "detectors_of",
    "evaluate",
    "spectrum_of",
    "times_of",
]

_CELL_WINDOWS: Final = 2.5
_PROFILE_BINS: Final = 60


def evaluate(
    matches: DomMatches, model: SensorModel, options: EvaluationOptions | None = None
) -> Evaluation:
    """Evaluate what an image's `model` is worth from its `matches` with a reference."""
    options = options or EvaluationOptions()
    used = matches.used & np.isfinite(matches.error_px).all(axis=1)
    if used.sum() < LEAST_POINTS:
        raise GeometryError(f"evaluation: at least {LEAST_POINTS} matches needed, got {used.sum()}")
    place, error = matches.model_px[used], matches.error_px[used]
    shift = matches.shift_en_m[used]
    stated_px2 = np.diagonal(matches.covariance_px2[used], axis1=1, axis2=2)
    stated_m2 = np.diagonal(matches.covariance_m2[used], axis1=1, axis2=2)
    window_px = matches.window_px * matches.pixel_m / float(np.mean(matches.ground_sample_m))
    cells = Cells.of(place, _CELL_WINDOWS * window_px)
    terms = relative_terms(options.relative, model, matches.ground[used], place)
    everywhere = np.ones(len(place), dtype=np.bool_)
    residual = error - fitted(terms, error, everywhere)
    held = chess_board(place)
    left_out = error - fitted(terms, error, ~held)
    noise_px2 = matching_noise(stated_px2, residual, place, window_px)
    noise_m2 = matching_noise(stated_m2, shift - shift.mean(axis=0), place, window_px)
    estimates, raw = absolute_errors(cells, shift, noise_m2, options.reference_sigma_m)
    for k, name in enumerate(("bias_line_px", "bias_sample_px")):
        estimates[name] = cells.mean(error[:, k])
    freedom = 1.0 - 0.5 * terms.shape[-1] / len(place)
    relative, relative_raw = relative_errors(cells, residual, noise_px2, freedom)
    estimates |= relative
    raw |= relative_raw
    for k, name in enumerate(("v_x", "v_y")):
        estimates[name] = held_out_mean(cells, left_out[:, k], held)
    for k, name in enumerate(("m_x_held_out", "m_y_held_out")):
        raw[name] = float(np.sqrt(np.mean(left_out[held, k] ** 2)))
    ordered = {name: estimates.pop(name) for name in KEYS} | estimates
    detector = detectors_of(model, place)
    return Evaluation(
        options=options,
        matches=matches,
        points=int(used.sum()),
        estimates=ordered,
        raw=raw,
        residual_px=residual,
        held_out=held,
        noise_px=(float(np.sqrt(noise_px2[0])), float(np.sqrt(noise_px2[1]))),
        along=profile(place[:, 0], residual, _bins(place[:, 0], window_px)),
        across=profile(place[:, 1], residual, _bins(place[:, 1], window_px)),
        spectrum=spectrum_of(matches, model, place, residual, options.line_period_s),
        ccds=_by_ccd(detector, residual),
    )


def _bins(coordinate: FloatArray, window_px: float) -> int:
    return int(np.clip(2.0 * np.ptp(coordinate) / window_px, 4, _PROFILE_BINS))


def detectors_of(model: SensorModel, place: FloatArray) -> IntArray:
    """Which CCD sees each point; one where the model tells none."""
    number = np.zeros(len(place), dtype=np.int64)
    if isinstance(model, PushbroomModel):
        firsts = [detector.first_sample - 0.5 for detector in model.camera.detectors]
        number = np.searchsorted(firsts[1:], place[:, 1], side="right").astype(np.int64)
    return number


def _by_ccd(detector: IntArray, residual: FloatArray) -> tuple[CcdError, ...]:
    out = []
    for number in np.unique(detector):
        own = residual[detector == number]
        mean, sigma = own.mean(axis=0), own.std(axis=0) / np.sqrt(max(len(own), 1))
        out.append(
            CcdError(
                int(number),
                len(own),
                (float(mean[0]), float(mean[1])),
                (float(sigma[0]), float(sigma[1])),
            )
        )
    return tuple(out)


def spectrum_of(
    matches: DomMatches,
    model: SensorModel,
    place: FloatArray,
    residual: FloatArray,
    line_period_s: float | None = None,
) -> ResidualSpectrum:
    """Vibrations in residuals (n, 2) at `place` (n, 2): over time where lines have one, else lines.

    `line_period_s` gives a model without times one.
    """
    time, period, unit = times_of(model, place[:, 0], line_period_s)
    down, right = (abs(n) * matches.window_px * period for n in matches.lines_per_pixel)
    return residual_spectrum(
        time,
        place[:, 1],
        residual,
        detector=detectors_of(model, place),
        window=(down, right),
        dependence=matches.dependence,
        unit=unit,
    )


def times_of(
    model: SensorModel, line_px: FloatArray, line_period_s: float | None = None
) -> tuple[FloatArray, float, str]:
    """Return times (n,) of lines, how long a line takes, and the unit of frequencies over them."""
    if isinstance(model, PushbroomModel):
        time = np.asarray(model.camera.timing.time_s(line_px), dtype=np.float64)
        return time, float(np.ptp(time) / max(float(np.ptp(line_px)), 1.0)), "Hz"
    if line_period_s is not None:
        return line_px * line_period_s, line_period_s, "Hz"
    return line_px, 1.0, "cycles per line"
