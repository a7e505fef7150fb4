"""Accuracy of an image from its matches with a reference: absolute and relative, with intervals.

Axes as P (9): x along the track (line), y across it (sample). All sizes are those of the image's
error: the variance that the matching states for itself is taken out of mean squares, and its own
uncertainty put into the intervals. The reference's accuracy, a constant error of unknown size and
direction as far as one scene shows, widens the intervals of the absolute numbers alone.

*Source*: P tables 1 and 2 for the relative numbers; the relative accuracy is hypot(Mx, My).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from geoposition.arrays import BoolArray, FloatArray, IntArray
from geoposition.calib_fields.intervals import Cells, Estimate
from geoposition.calib_fields.match import DomMatches
from geoposition.calib_fields.profiles import (
    Profile,
    ResidualSpectrum,
    profile,
    residual_spectrum,
)
from geoposition.calib_fields.relative import Relative, fitted, relative_terms
from geoposition.errors import ArgumentError, GeometryError
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel

KEYS: Final = (
    "bias_e_m",
    "bias_n_m",
    "rmse_e_m",
    "rmse_n_m",
    "ce90_m",
    "relative_px",
    "v_x",
    "v_y",
    "m_x",
    "m_y",
)
"""Numbers that every evaluation has, each with an interval."""
_LEAST_POINTS: Final = 12
_CE: Final = 0.9
_NOISE_DOUBT: Final = 0.15
"""Relative uncertainty of the standard deviations that the matching states."""
_DENSITY: Final = 0.06
"""Share to either side of a quantile over which the density is taken."""
_FOLDS: Final = 8
_CELL_WINDOWS: Final = 2.5
_PROFILE_BINS: Final = 60


@dataclass(frozen=True, slots=True)
class EvaluationOptions:
    """What is removed before the relative numbers, and how well the reference is known.

    `reference_sigma_m` is the standard deviation per axis of the reference's own place, 0 where
    nothing is stated. `line_period_s` gives a model without times a frequency in Hz.
    """

    relative: Relative = "shift"
    reference_sigma_m: float = 0.0
    line_period_s: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.reference_sigma_m < 1e4:
            raise ArgumentError(
                f"reference accuracy: metres, 0 or more, expected, got {self.reference_sigma_m:g}"
            )
        if self.line_period_s is not None and not self.line_period_s > 0.0:
            raise ArgumentError(f"line period: positive seconds expected, got {self.line_period_s}")


@dataclass(frozen=True, slots=True)
class CcdError:
    """Mean residual (line, sample) of the points of one CCD, with its standard deviation."""

    number: int
    points: int
    mean_px: tuple[float, float]
    sigma_px: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """The numbers of `KEYS` and some more, and what they come from.

    `bias_e_m`, `bias_n_m` is the shift that brings the image onto the reference (reference less
    located); `bias_line_px`, `bias_sample_px` the place observed in the image less the modelled
    one. `v_x`, `v_y` are means over points held out of the fit, `m_x`, `m_y` root mean squares
    about the fit to all. `residual_px` (n, 2) are residuals of that fit at the points `used`.
    """

    options: EvaluationOptions
    matches: DomMatches
    points: int
    estimates: dict[str, Estimate]
    raw: dict[str, float]
    residual_px: FloatArray
    held_out: BoolArray
    noise_px: tuple[float, float]
    along: Profile
    across: Profile
    spectrum: ResidualSpectrum
    ccds: tuple[CcdError, ...]

    def as_dict(self) -> dict[str, object]:
        """Return the numbers as JSON has them: `points`, each number and its interval, the rest."""
        out: dict[str, object] = {"points": self.points}
        for name, estimate in self.estimates.items():
            out[name] = estimate.value
            out[f"{name}_interval"] = list(estimate.interval)
        out |= {
            "bias_means": "reference less located: what brings the image onto the reference",
            "relative_removes": self.options.relative,
            "axes": "x along the track (line), y across it (sample), pixels of the image",
            "reference_sigma_m": self.options.reference_sigma_m,
            "matching_sigma_px": list(self.noise_px),
            "as_measured": self.raw,
            "held_out_points": int(self.held_out.sum()),
            "rejected": {k: v for k, v in self.matches.counts.items() if k != "used"},
            "tried": len(self.matches.cause),
            "jitter": [
                {
                    "frequency": line.frequency,
                    "unit": self.spectrum.unit,
                    "frequency_sigma": line.sigma_frequency,
                    "amplitude_x_px": line.amplitude_px[0],
                    "amplitude_y_px": line.amplitude_px[1],
                    "amplitude_sigma_px": line.sigma_amplitude_px,
                }
                for line in self.spectrum.lines
            ],
            "ccds": [
                {
                    "ccd": ccd.number,
                    "points": ccd.points,
                    "mean_x_px": ccd.mean_px[0],
                    "mean_y_px": ccd.mean_px[1],
                }
                for ccd in self.ccds
            ],
        }
        return out


def evaluate(
    matches: DomMatches, model: SensorModel, options: EvaluationOptions | None = None
) -> Evaluation:
    """Evaluate what an image's `model` is worth from its `matches` with a reference."""
    options = options or EvaluationOptions()
    used = matches.used & np.isfinite(matches.error_px).all(axis=1)
    if used.sum() < _LEAST_POINTS:
        raise GeometryError(
            f"evaluation: at least {_LEAST_POINTS} matches needed, got {used.sum()}"
        )
    place, error = matches.model_px[used], matches.error_px[used]
    shift = matches.shift_en_m[used]
    stated_px2 = np.diagonal(matches.covariance_px2[used], axis1=1, axis2=2)
    stated_m2 = np.diagonal(matches.covariance_m2[used], axis1=1, axis2=2)
    window_px = matches.window_px * matches.pixel_m / float(np.mean(matches.ground_sample_m))
    cells = Cells.of(place, _CELL_WINDOWS * window_px)
    terms = relative_terms(options.relative, model, matches.ground[used], place)
    everywhere = np.ones(len(place), dtype=np.bool_)
    residual = error - fitted(terms, error, everywhere)
    held = _held_out(place)
    left_out = error - fitted(terms, error, ~held)
    noise_px2 = _noise(stated_px2, residual, place, window_px)
    noise_m2 = _noise(stated_m2, shift - shift.mean(axis=0), place, window_px)
    estimates, raw = _absolute(cells, shift, noise_m2, options.reference_sigma_m)
    for k, name in enumerate(("bias_line_px", "bias_sample_px")):
        estimates[name] = cells.mean(error[:, k])
    freedom = 1.0 - 0.5 * terms.shape[-1] / len(place)
    relative, relative_raw = _relative(cells, residual, noise_px2, freedom)
    estimates |= relative
    raw |= relative_raw
    for k, name in enumerate(("v_x", "v_y")):
        estimates[name] = _difference(cells, left_out[:, k], held)
    for k, name in enumerate(("m_x_held_out", "m_y_held_out")):
        raw[name] = float(np.sqrt(np.mean(left_out[held, k] ** 2)))
    ordered = {name: estimates.pop(name) for name in KEYS} | estimates
    dependence = max(1.0, (matches.window_px / matches.spacing_px) ** 2)
    detector = _detectors(model, place)
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
        spectrum=_spectrum(matches, model, options, place, residual, detector, dependence),
        ccds=_by_ccd(detector, residual),
    )


def _held_out(place: FloatArray) -> BoolArray:
    """Choose half of the points: the dark fields of a chess board over the image."""
    low, size = place.min(axis=0), np.maximum(np.ptp(place, axis=0), 1.0)
    field = np.minimum(((place - low) / size * _FOLDS).astype(np.int64), _FOLDS - 1)
    held: BoolArray = field.sum(axis=1) % 2 == 1
    if not 0.2 < held.mean() < 0.8:
        held = np.arange(len(place)) % 2 == 1
    return held


def _absolute(
    cells: Cells, shift: FloatArray, noise_m2: FloatArray, reference_m: float
) -> tuple[dict[str, Estimate], dict[str, float]]:
    estimates, raw = {}, {}
    for k, axis in enumerate("en"):
        mean = cells.mean(shift[:, k])
        estimates[f"bias_{axis}_m"] = mean.widened(reference_m)
        square = _mean_square(cells, shift[:, k], noise_m2[k])
        # what a constant error of the reference does to a mean square
        moved = float(np.hypot(2.0 * mean.mean * reference_m, np.sqrt(2.0) * reference_m**2))
        estimates[f"rmse_{axis}_m"] = square.widened(moved)
        raw[f"rmse_{axis}_m"] = float(np.sqrt(np.mean(shift[:, k] ** 2)))
    raw["ce90_m"] = float(np.quantile(np.hypot(*shift.T), _CE))
    estimates["ce90_m"] = _circular(cells, shift, noise_m2).widened(reference_m)
    return estimates, raw


def _relative(
    cells: Cells, residual: FloatArray, noise_px2: FloatArray, freedom: float
) -> tuple[dict[str, Estimate], dict[str, float]]:
    estimates, raw = {}, {}
    for k, axis in enumerate("xy"):
        estimates[f"m_{axis}"] = _mean_square(cells, residual[:, k], noise_px2[k], freedom)
        raw[f"m_{axis}"] = float(np.sqrt(np.mean(residual[:, k] ** 2)))
    estimates["relative_px"] = _mean_square(
        cells, np.hypot(*residual.T), float(noise_px2.sum()), freedom
    )
    raw["relative_px"] = float(np.hypot(raw["m_x"], raw["m_y"]))
    return estimates, raw


def _noise(
    stated: FloatArray, residual: FloatArray, place: FloatArray, window_px: float
) -> FloatArray:
    """Variance (2,) of the matching: as stated, or less where neighbours agree better than that.

    Neighbours share lines as far as they can, so that a vibration does not count, but no pixels.
    """
    near = cKDTree(place).query_ball_point(place, 2.5 * window_px)
    first, second = [], []
    for k, others in enumerate(near):
        away = place[others] - place[k]
        apart = np.flatnonzero(np.abs(away).max(axis=1) >= window_px)
        if apart.size:
            first.append(k)
            second.append(others[apart[int(np.argmin(np.abs(away[apart, 0])))]])
    said: FloatArray = stated.mean(axis=0)
    if len(first) < _LEAST_POINTS:
        return said
    difference = residual[first] - residual[second]
    result: FloatArray = np.minimum(said, 0.5 * np.mean(difference**2, axis=0))
    return result


def _mean_square(cells: Cells, error: FloatArray, own: float, freedom: float = 1.0) -> Estimate:
    """Mean square of errors without the matching's `own` variance."""
    found = cells.mean(error**2)
    doubt = 2.0 * _NOISE_DOUBT * own
    mean = max(found.mean / freedom - own, 0.0)
    return Estimate(mean, float(np.hypot(found.sigma, doubt)), found.freedom, squared=True)


def _circular(cells: Cells, shift: FloatArray, own: FloatArray) -> Estimate:
    """CE90 of errors drawn together to their scatter without the matching's."""
    middle = shift.mean(axis=0)
    scatter = np.maximum(shift.var(axis=0), 1e-12)
    shrink = np.sqrt(np.maximum(scatter - own, 0.0) / scatter)
    size = np.hypot(*(middle + shrink * (shift - middle)).T)
    radius = float(np.quantile(size, _CE))
    # deviation of a quantile: that of the share below it, over the density there
    below = cells.mean((size <= radius).astype(np.float64))
    low, high = np.quantile(size, [_CE - _DENSITY, _CE + _DENSITY])
    sampled = below.sigma * float(high - low) / (2.0 * _DENSITY)
    # where all sizes are alike the mean's own deviation is left
    moved = max(cells.mean(shift[:, k]).sigma for k in (0, 1))
    doubt = _NOISE_DOUBT * float(own.mean()) / max(radius, float(np.sqrt(own.mean())), 1e-12)
    return Estimate(radius, float(np.sqrt(sampled**2 + moved**2 + doubt**2)), below.freedom)


def _difference(cells: Cells, left_out: FloatArray, held: BoolArray) -> Estimate:
    """Mean over held-out points; the fit's own deviation counts as much as theirs.

    Which points are held out is chance, so that smooth errors are scatter here.
    """
    there, here = cells.mean(left_out, held, 0), cells.mean(left_out, ~held, 0)
    sigma = float(np.hypot(there.sigma, here.sigma))
    return Estimate(there.mean, sigma, min(there.freedom, here.freedom))


def _bins(coordinate: FloatArray, window_px: float) -> int:
    return int(np.clip(2.0 * np.ptp(coordinate) / window_px, 4, _PROFILE_BINS))


def _detectors(model: SensorModel, place: FloatArray) -> IntArray:
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


def _spectrum(
    matches: DomMatches,
    model: SensorModel,
    options: EvaluationOptions,
    place: FloatArray,
    residual: FloatArray,
    detector: IntArray,
    dependence: float,
) -> ResidualSpectrum:
    """Vibrations over time where lines have one, else over lines."""
    period, unit, time = 1.0, "cycles per line", place[:, 0]
    if isinstance(model, PushbroomModel):
        time = np.asarray(model.camera.timing.time_s(place[:, 0]), dtype=np.float64)
        period = float(np.ptp(time) / max(float(np.ptp(place[:, 0])), 1.0))
        unit = "Hz"
    elif options.line_period_s is not None:
        period, unit = options.line_period_s, "Hz"
        time = place[:, 0] * period
    down, right = (abs(n) * matches.window_px * period for n in matches.lines_per_pixel)
    return residual_spectrum(
        time,
        place[:, 1],
        residual,
        detector=detector,
        window=(down, right),
        dependence=dependence,
        unit=unit,
    )
