"""Fusion of star samples and gyro as the command line asks for it, and what it found."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, GeometryError
from geoposition.scripts.attitude.input import (
    ARCSEC_RAD,
    Sources,
    Telemetry,
    agree,
    load,
    named,
    spans,
)
from geoposition.scripts.results import Progress
from geoposition.sensors.attitude_determination.estimate import AttitudeEstimate
from geoposition.sensors.attitude_determination.noise.noise_levels import (
    NoiseLevels,
    estimate_noise,
)
from geoposition.sensors.attitude_determination.resample import at_times, regular_times
from geoposition.sensors.attitude_determination.settings import FusionSettings
from geoposition.sensors.readers.attitude_columns import PRESETS
from geoposition.sensors.readers.table_file import load_table
from geoposition.sensors.readers.table_times import read_times
from geoposition.sensors.telemetry import GyroNoise, StarSeries
from geoposition.sensors.writers.attitude_table import estimate_columns
from geoposition.sensors.writers.table_file import write_table

DEG_H: Final = float(np.pi / 648000.0)
"""One degree per hour in rad/s."""
START_NOISE: Final = GyroNoise(1e-6, 1e-9)
"""From where the estimate of the noise starts, and what is known while it runs."""
_WILD_NIS: Final = 30.0
"""Mean NIS, 3 where all is right, from which on the estimate deserves a warning."""

_METHODS: Final = {
    "ekf": ("filters.ekf", "filter_forward"),
    "ukf": ("filters.ukf", "filter_forward"),
    "cf": ("filters.complementary", "filter_forward"),
    "cf-ukf": ("filters.complementary", "cf_ukf"),
    "rts": ("smoothers.smooth", "rts"),
    "two-filter": ("smoothers.smooth", "two_filter"),
    "graph": ("graph.factor_graph", "smooth"),
}


@dataclass(frozen=True, slots=True)
class Options:
    """How to fuse, in the units of the command line."""

    method: str = "rts"
    gyro_model: Literal["bias", "general"] = "bias"
    angle_random_walk: float | None = None
    rate_random_walk: float | None = None
    bias_sigma_deg_h: float = 2.0
    scale_sigma_ppm: float = 2000.0
    misalignment_sigma_ppm: float = 2000.0
    gate: float | None = None
    robust: bool = False
    rate_hz: float | None = None
    at: Path | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FusionRun:
    """The estimate at the epochs asked for, and at those of the method; words about both."""

    telemetry: Telemetry
    settings: FusionSettings
    options: Options
    estimate: AttitudeEstimate
    asked: AttitudeEstimate
    summary: dict[str, object]


def fuse(sources: Sources, options: Options, progress: Progress) -> FusionRun:
    """Read, settle the noise, fuse, and bring the estimate to the epochs asked for."""
    telemetry = load(sources)
    times = None if options.at is None else _times_of(options.at)
    progress(1, 4)
    try:
        warnings = agree(telemetry)
        begun = time.perf_counter()
        telemetry, settings, noise_facts = settle_noise(telemetry, options)
        progress(2, 4)
        estimate = run_method(telemetry, settings, options)
    except (ArgumentError, GeometryError) as error:
        raise named(error, sources) from None
    warnings |= _doubt(estimate)
    progress(3, 4)
    elapsed = time.perf_counter() - begun
    asked = estimate
    if options.rate_hz is not None:
        asked = at_times(estimate, regular_times(estimate, options.rate_hz))
    elif times is not None:
        asked = at_times(estimate, times)
    summary: dict[str, object] = {
        "method": options.method,
        "gyro_model": options.gyro_model,
        "epochs": len(asked.times_s),
        "span_s": [float(asked.times_s[0]), float(asked.times_s[-1])],
        **spans(telemetry.star, telemetry.gyro),
        **telemetry.facts,
        **warnings,
        "noise": noise_facts,
        **estimate_facts(estimate),
        "elapsed_s": round(elapsed, 3),
    }
    return FusionRun(telemetry, settings, options, estimate, asked, summary)


def write(path: Path, run: FusionRun) -> None:
    """Write the table of the contract."""
    write_table(path, estimate_columns(run.asked))


def run_method(
    telemetry: Telemetry, settings: FusionSettings, options: Options
) -> AttitudeEstimate:
    """Return what the chosen method makes of the telemetry."""
    module, name = _METHODS[options.method]
    package = "geoposition.sensors.attitude_determination"
    method: Callable[..., AttitudeEstimate] = getattr(import_module(f"{package}.{module}"), name)
    more: dict[str, Any] = {}
    if options.robust:
        graph = import_module(f"{package}.graph.factor_graph")
        loss = import_module(f"{package}.graph.robust")
        more["options"] = graph.GraphOptions(robust=loss.RobustNoise("huber"))
    return method(telemetry.star, telemetry.need_gyro, settings, telemetry.mounting, **more)


def settle_noise(
    telemetry: Telemetry, options: Options
) -> tuple[Telemetry, FusionSettings, dict[str, object]]:
    """Noise as given, and estimated from the data where not."""
    given = (options.angle_random_walk, options.rate_random_walk)
    walk, rate_walk = given
    settings = FusionSettings(
        GyroNoise(
            START_NOISE.angle_random_walk if walk is None else walk,
            START_NOISE.rate_random_walk if rate_walk is None else rate_walk,
        ),
        options.gyro_model,
        options.bias_sigma_deg_h * DEG_H,
        options.scale_sigma_ppm * 1e-6,
        options.misalignment_sigma_ppm * 1e-6,
        options.gate,
    )
    if telemetry.sigma_stated and None not in given:
        return telemetry, settings, _noise_facts(telemetry.star, settings.noise)
    try:
        levels = estimate_noise(telemetry.star, telemetry.need_gyro, settings, telemetry.mounting)
    except GeometryError as error:
        raise GeometryError(
            f"{error}; or give --star-sigma-arcsec, --angle-random-walk and --rate-random-walk"
        ) from None
    settings = replace(
        settings,
        noise=GyroNoise(
            levels.noise.angle_random_walk if walk is None else walk,
            levels.noise.rate_random_walk if rate_walk is None else rate_walk,
        ),
    )
    if not telemetry.sigma_stated:
        telemetry = replace(telemetry, star=_with_levels(telemetry.star, levels))
    facts = _noise_facts(telemetry.star, settings.noise)
    names = ["angle_random_walk", "rate_random_walk"]
    names += [f"{head}_{part}" for head in telemetry.star.heads for part in ("cross", "bore")]
    wanted = [walk is None, rate_walk is None]
    wanted += [not telemetry.sigma_stated] * (len(names) - 2)
    facts["estimated"] = [name for name, yes in zip(names, wanted, strict=True) if yes]
    facts["relative_sigma"] = {
        name: value
        for name, value, yes in zip(names, levels.relative_sigma.tolist(), wanted, strict=True)
        if yes
    }
    return telemetry, settings, facts


def _with_levels(star: StarSeries, levels: NoiseLevels) -> StarSeries:
    """Return the series with the estimated noise.

    Of a head whose noise across or about the boresight the data do not determine, both are taken
    as what they do determine: near zero is where a search ends that finds nothing.
    """
    known = np.isfinite(levels.relative_sigma[2:]).reshape(-1, 2)
    scaled = levels.rescaled(star)
    cross, bore = np.array(scaled.sigma_cross_rad), np.array(scaled.sigma_bore_rad)
    only_bore = (known[:, 1] & ~known[:, 0])[star.head]
    only_cross = (known[:, 0] & ~known[:, 1])[star.head]
    cross[only_bore], bore[only_cross] = bore[only_bore], cross[only_cross]
    return StarSeries.of(star.times_s, star.quat_xyzw, cross, bore, star.head, star.heads)


def _noise_facts(star: StarSeries, noise: GyroNoise) -> dict[str, object]:
    return {
        "star_sigma_arcsec": {
            name: [
                float(np.median(sigma[star.head == head]) / ARCSEC_RAD)
                for sigma in (star.sigma_cross_rad, star.sigma_bore_rad)
            ]
            for head, name in enumerate(star.heads)
            if np.any(star.head == head)
        },
        "angle_random_walk": noise.angle_random_walk,
        "rate_random_walk": noise.rate_random_walk,
        "estimated": [],
    }


def estimate_facts(estimate: AttitudeEstimate) -> dict[str, object]:
    """Return what an estimate says of itself: sigmas, gyro errors at its end, innovations."""
    last = len(estimate.times_s) - 1
    sigma = np.sqrt(np.maximum(np.diagonal(estimate.covariance[last]), 0.0))
    facts: dict[str, object] = {
        "sigma_arcsec": _axes(np.mean(estimate.sigma_rad, axis=0) / ARCSEC_RAD),
        "bias_deg_h": _axes(estimate.bias_rad_s[last] / DEG_H),
        "bias_sigma_deg_h": _axes(sigma[3:6] / DEG_H),
    }
    if len(sigma) > 6:
        names = [f"{kind}_{i}" for kind in ("scale", "upper", "lower") for i in (1, 2, 3)]
        facts["parameters_ppm"] = {
            name: {"value": 1e6 * value, "sigma": 1e6 * error}
            for name, value, error in zip(
                names, estimate.parameters[last].tolist(), sigma[6:].tolist(), strict=True
            )
        }
    if estimate.innovations is not None:
        facts["innovations"] = innovation_facts(estimate)
    return facts


def innovation_facts(estimate: AttitudeEstimate) -> dict[str, object]:
    """Innovations used and rejected, their size, and the mean NIS with its 95 % band."""
    from scipy.stats import chi2

    kept = estimate.innovations
    assert kept is not None
    met = np.isfinite(kept.residual_rad).all(axis=1)
    used = met & kept.accepted
    facts: dict[str, object] = {
        "used": int(used.sum()),
        "rejected": int(np.sum(met & ~kept.accepted)),
        "not_met": int(np.sum(~met)),
    }
    if used.any():
        rms = np.sqrt(np.mean(kept.residual_rad[used] ** 2, axis=0)) / ARCSEC_RAD
        picked = replace(
            kept,
            times_s=kept.times_s[used],
            residual_rad=kept.residual_rad[used],
            covariance_rad2=kept.covariance_rad2[used],
            accepted=kept.accepted[used],
        )
        count = int(used.sum())
        facts["rms_arcsec"] = _axes(rms)
        facts["mean_nis"] = float(np.mean(picked.normalised_squared()))
        facts["nis_band"] = (chi2.ppf([0.025, 0.975], 3 * count) / count).tolist()
    return facts


def _doubt(estimate: AttitudeEstimate) -> dict[str, object]:
    """Return a warning where innovations are far larger than the noise explains."""
    if estimate.innovations is None:
        return {}
    found = innovation_facts(estimate).get("mean_nis")
    if not isinstance(found, float) or found < _WILD_NIS:
        return {}
    return {
        "warning": f"star samples are off by {np.sqrt(found / 3.0):.1f} times the stated noise: "
        "check it, the mountings and the gyro's"
    }


def _axes(values: FloatArray) -> dict[str, float]:
    return dict(zip("xyz", np.asarray(values).tolist(), strict=True))


def _times_of(path: Path) -> FloatArray:
    table = load_table(path)
    table.require(("t_s",))
    times, _ = read_times(table, PRESETS["contract"].time)
    return times
