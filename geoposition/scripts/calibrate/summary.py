"""A calibration in figures, as JSON has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geoposition.calib_fields.calibration import ARCSEC_RAD, Calibration, SceneCheck, SpreadCheck

if TYPE_CHECKING:
    from geoposition.scripts.calibrate.run import CalibrationResult


def summary_of(result: CalibrationResult) -> dict[str, object]:
    """Names and figures: angles in arcseconds, curves in pixels of the camera."""
    done = result.calibration
    adjustment = done.adjustment
    return {
        "scenes": [
            {
                "name": name,
                "product": str(found.product.path),
                "points": int(used.sum()),
                "rejected": {k: n for k, n in found.matches.counts.items() if k != "used"},
                "residual_rms_px": _rms(residual[used]),
                "vibrations": [
                    {"frequency_hz": line.frequency, "amplitude_px": list(line.amplitude_px)}
                    for line in lines
                ],
            }
            for name, found, used, residual, lines in zip(
                result.names,
                result.scenes,
                done.used,
                done.residual_px,
                done.vibrations,
                strict=True,
            )
        ],
        "points": done.points,
        "degree": done.options.degree,
        "sigma0": adjustment.sigma0,
        "redundancy": adjustment.redundancy,
        "pixel_arcsec": done.pixel_rad / ARCSEC_RAD,
        "mounting_arcsec": _triple(done.mounting_rad),
        "mounting_sigma_arcsec": _triple(done.mounting_sigma_rad),
        "parameters": _parameters(done),
        "curves": [
            {
                "ccd": curve.ccd,
                "sample": curve.sample,
                "change_px": curve.change_px,
                "sigma_px": curve.sigma_px,
                "shape_px": curve.shape_px,
                "shape_sigma_px": curve.shape_sigma_px,
            }
            for curve in done.curves
        ],
        "correlations": dict(done.correlations),
        "correlated": [
            {"unknowns": [a, b], "correlation": value} for a, b, value in adjustment.correlated
        ],
        "not_determined": [
            {"combination": dict(weak.parts), "gain": weak.gain} for weak in adjustment.weak
        ],
        "held_out_points": [_points(check) for check in done.checks],
        "held_out_scenes": [_scene(check) for check in result.held_out],
    }


def _rms(residual: np.ndarray) -> list[float]:
    value: list[float] = np.sqrt(np.mean(residual**2, axis=0)).tolist()
    return value


def _triple(angle_rad: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", (angle_rad / ARCSEC_RAD).tolist(), strict=True))


def _parameters(done: Calibration) -> dict[str, dict[str, object]]:
    a = done.adjustment
    return {
        name: {
            "value_arcsec": float(value) / ARCSEC_RAD,
            "sigma_arcsec": float(sigma) / ARCSEC_RAD,
            "determined": float(gain),
            "per": unit.removeprefix("rad").removeprefix("/") or None,
        }
        for name, value, sigma, gain, unit in zip(
            a.names, a.values, a.sigma, a.gain, a.units, strict=True
        )
    }


def _points(check: SpreadCheck) -> dict[str, object]:
    return {
        "name": check.name,
        "points": check.points,
        "rms_before_px": list(check.before_px),
        "rms_after_px": list(check.after_px),
        "matching_sigma_px": list(check.stated_px),
    }


def _scene(check: SceneCheck) -> dict[str, object]:
    out: dict[str, object] = {"name": check.name, "points": check.after.points}
    names = ("relative_px", "m_x", "m_y", "bias_line_px", "bias_sample_px", "bias_e_m", "bias_n_m")
    for suffix, found in (("_before", check.before), ("", check.after)):
        for name in names:
            estimate = found.estimates[name]
            out[f"{name}{suffix}"] = estimate.value
            out[f"{name}{suffix}_interval"] = list(estimate.interval)
    return out
