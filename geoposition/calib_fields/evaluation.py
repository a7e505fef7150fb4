"""The result of an evaluation: each number with its interval, and what they come from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from geoposition.arrays import BoolArray, FloatArray
from geoposition.calib_fields.intervals import Estimate
from geoposition.calib_fields.matches import DomMatches
from geoposition.calib_fields.profiles import Profile, ResidualSpectrum
from geoposition.calib_fields.relative import Relative
from geoposition.errors import ArgumentError

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
