"""The HTML page about a fusion: estimates, 3-sigma bands, drift, innovations, spectra."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import SlerpCurve
from geoposition.scripts.attitude import figures as draw
from geoposition.scripts.attitude.fusion import DEG_H, FusionRun
from geoposition.scripts.attitude.input import ARCSEC_RAD
from geoposition.scripts.attitude.report import BODY, write_page
from geoposition.scripts.report import (
    Block,
    Image,
    KeyFigure,
    Note,
    Report,
    Section,
    Table,
    Text,
    number,
    provenance,
)
from geoposition.sensors.attitude_determination.jitter.orbit_angles import body_roll_pitch_yaw
from geoposition.sensors.attitude_determination.signal.low_pass import low_pass
from geoposition.sensors.attitude_determination.signal.spectrum import spectrum

_LEAST_FOR_SPECTRUM: Final = 64
_SMOOTHERS: Final = ("rts", "two-filter", "graph")


def write(path: Path, run: FusionRun) -> None:
    """Write the page, whole or not at all."""
    write_page(path, build(run))


def build(run: FusionRun) -> Report:
    """Put the page's pieces together."""
    summary: Any = run.summary
    sigma = summary["sigma_arcsec"]
    keys = [KeyFigure(number(sigma[a], 3), "″", f"{a}, σ, mean over the run") for a in BODY]
    found = summary.get("innovations", {})
    if "mean_nis" in found:
        low, high = found["nis_band"]
        keys.append(
            KeyFigure(number(found["mean_nis"], 2), "", "mean NIS",
                      f"{number(low, 2)} to {number(high, 2)} if the noise is right")
        )  # fmt: skip
    sections = [
        Section("Attitude", _attitude(run)),
        Section("Gyro drift", _drift(run)),
    ]
    if "parameters_ppm" in summary:
        sections.append(Section("Scale factors and misalignments", [_parameters(summary)]))
    if run.estimate.innovations is not None:
        sections.append(Section("Innovations", _innovations(run)))
    if len(run.estimate.times_s) >= _LEAST_FOR_SPECTRUM:
        sections.append(Section("Spectra", _spectra(run)))
    sections.append(Section("Input", _input(summary)))
    first, last = summary["span_s"]
    return Report(
        f"Fused attitude, {summary['method']}",
        f"{summary['star_samples']} star samples of {len(summary['heads'])} head(s) and "
        f"{summary['gyro_samples']} gyro samples over {last - first:.1f} s, gyro model "
        f"{summary['gyro_model']}.",
        keys,
        sections,
        provenance({"method": summary["method"], "gyro model": summary["gyro_model"]}),
    )


def _attitude(run: FusionRun) -> list[Block]:
    estimate = run.estimate
    times = estimate.times_s
    turned = np.degrees(body_roll_pitch_yaw(times, estimate.R_inertial_body))
    at, difference = star_minus_estimate(run)
    blocks: list[Block] = [
        Image(
            draw.bands(draw.Band(times, turned), BODY, "°"),
            "Angles turned about the body's axes since the first epoch.",
            "Estimated attitude over time",
        ),
        Image(
            draw.bands(
                draw.Band(
                    times, np.zeros_like(turned), estimate.sigma_rad / ARCSEC_RAD,
                    (at, difference / ARCSEC_RAD),
                ),
                BODY, "″",
            ),
            "Three sigma of the estimate as a band; dots are star samples minus the estimate.",
            "Standard deviations of the attitude over time",
        ),
    ]  # fmt: skip
    if run.options.method in ("cf", "cf-ukf"):
        blocks.append(
            Note(
                "The complementary filter feeds a function of its own prediction back as a "
                "measurement: its standard deviations are too small."
            )
        )
    return blocks


def star_minus_estimate(run: FusionRun) -> tuple[FloatArray, FloatArray]:
    """Return times (m,) and rotation vectors (m, 3), in the body, estimate to star samples."""
    estimate, star = run.estimate, run.telemetry.star
    inside = (star.times_s >= estimate.times_s[0]) & (star.times_s <= estimate.times_s[-1])
    kept = star.where(inside)
    to_body = [run.telemetry.mounting.rotation(name).inv().as_quat() for name in kept.heads]
    measured = kept.R_inertial_sensor * Rotation.from_quat(np.array(to_body)[kept.head])
    between = SlerpCurve.through(estimate.times_s, estimate.quat_xyzw).rotation(kept.times_s)
    return kept.times_s, np.asarray((between.inv() * measured).as_rotvec())


def _drift(run: FusionRun) -> list[Block]:
    estimate = run.estimate
    variance = np.einsum("nii->ni", estimate.covariance)[:, 3:6]
    band = draw.Band(
        estimate.times_s,
        estimate.bias_rad_s / DEG_H,
        np.sqrt(np.maximum(variance, 0.0)) / DEG_H,
    )
    return [
        Image(
            draw.bands(band, BODY, "°/h"),
            "Gyro bias with a band of three sigma.",
            "Gyro bias over time",
        )
    ]


def _parameters(summary: Any) -> Table:
    rows = [
        [name.replace("_", " "), number(found["value"], 1, sign=True), number(found["sigma"], 1)]
        for name, found in summary["parameters_ppm"].items()
    ]
    return Table("At the last epoch, ppm", ["", "estimate", "σ"], rows)


def _innovations(run: FusionRun) -> list[Block]:
    kept = run.estimate.innovations
    assert kept is not None
    met = np.isfinite(kept.residual_rad).all(axis=1)
    sigma = np.sqrt(np.einsum("nii->ni", kept.covariance_rad2[met]))
    facts: Any = run.summary["innovations"]
    words = f"{facts['used']} used, {facts['rejected']} rejected by the gate (crosses)."
    if run.options.method in _SMOOTHERS:
        words += " They are those of the forward pass, or of the final estimate for the graph."
    return [
        Text(words),
        Image(
            draw.innovations(
                kept.times_s[met], kept.residual_rad[met] / ARCSEC_RAD, sigma / ARCSEC_RAD,
                kept.accepted[met], "″",
            ),
            "Star sample minus prediction in the body; lines are three of their sigmas.",
            "Innovations over time",
        ),
    ]  # fmt: skip


def _spectra(run: FusionRun) -> list[Block]:
    times = run.estimate.times_s
    turned = body_roll_pitch_yaw(times, run.estimate.R_inertial_body)
    cut = max(10.0 / float(times[-1] - times[0]), 0.005)
    drawn = spectrum(times, turned - low_pass(times, turned, cut), segments=8)
    return [
        Image(
            draw.spectra(
                drawn.frequency_hz, drawn.density / ARCSEC_RAD**2, BODY, "″²/Hz",
                (drawn.low, drawn.high),
            ),
            f"Power density of the estimated angles above {cut:.3g} Hz, with its "
            f"{drawn.confidence:.0%} confidence.",
            "Spectra of the estimated angles",
        )
    ]  # fmt: skip


def _input(summary: Any) -> list[Block]:
    noise = summary["noise"]
    rows = [
        [f"{head}, across", f"{sigma[0]:.3g} ″"]
        for head, sigma in noise["star_sigma_arcsec"].items()
    ] + [
        [f"{head}, boresight", f"{sigma[1]:.3g} ″"]
        for head, sigma in noise["star_sigma_arcsec"].items()
    ]
    rows.append(["angle random walk", f"{noise['angle_random_walk']:.3g} rad/√s"])
    rows.append(["rate random walk", f"{noise['rate_random_walk']:.3g} rad/s^1.5"])
    blocks: list[Block] = [Table("Noise", ["what", "value"], rows)]
    if noise["estimated"]:
        blocks.append(Text(f"Estimated from the data: {', '.join(noise['estimated'])}."))
    if "warning" in summary:
        blocks.append(Note(str(summary["warning"])))
    return blocks
