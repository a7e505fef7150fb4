"""Figures of the thesis experiment as PNG bytes."""

from __future__ import annotations

from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from geoposition.scripts.experiments.thesis.attitude_chain import AttitudeChain
from geoposition.scripts.experiments.thesis.fusion import KINDS, Kind
from geoposition.scripts.experiments.thesis.imaged import Imaged
from geoposition.scripts.experiments.thesis.numerical import Numerical
from geoposition.scripts.figures import COLOURS, STYLE, png
from geoposition.sensors.attitude_determination.jitter.lines import AXES
from geoposition.sensors.simulate import ARCSEC_RAD

NAMES: Final[dict[Kind, str]] = {
    "raw": "raw star attitude",
    "fused": "fused attitude",
    "true": "true attitude",
}


def runs_rmse(done: Numerical, limit_m: float) -> bytes:
    """Each run's RMSE at the check points, before and after, against the limit."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 3.0), layout="constrained")
        panels = figure.subplots(1, 2, width_ratios=(1.0, 1.0))
        for stage, (axes, title) in enumerate(
            zip(panels, ("before compensation", "after compensation"), strict=True)
        ):
            for k, kind in enumerate(KINDS):
                squares = [np.mean(np.sum(r.errors[kind].enu_m[stage] ** 2, axis=1))
                           for r in done.runs]  # fmt: skip
                share = (np.arange(len(squares)) + 0.5) / len(squares)
                axes.plot(np.sort(np.sqrt(squares)), share, color=COLOURS[k], label=NAMES[kind])
            axes.set_title(title)
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.set_xlabel("RMSE in space, m")
            axes.set_ylim(0.0, 1.0)
        panels[1].axvline(limit_m, color="#333333", ls="--", lw=1.0, label="limit of image noise")
        panels[0].set_ylabel("share of runs below")
        panels[1].legend(loc="center", fontsize=7.5)
        return png(figure)


def jitter_spectrum(chain: AttitudeChain) -> bytes:
    """Amplitude density of the fused attitude in the orbit frame, with the lines found."""
    drawn = chain.jitter.spectrum
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.8), layout="constrained")
        axes = figure.add_subplot()
        positive = drawn.frequency_hz > 0.0
        for k, name in enumerate(AXES):
            density = np.sqrt(drawn.density[positive, k]) / ARCSEC_RAD
            axes.loglog(drawn.frequency_hz[positive], density, color=COLOURS[k], lw=0.9, label=name)
            for peak in chain.jitter.axes[name]:
                axes.axvline(peak.frequency_hz, color=COLOURS[k], lw=0.6, ls=":")
        axes.set_xlabel("frequency, Hz")
        axes.set_ylabel("″ / √Hz")
        axes.legend()
        return png(figure)


def attitude_errors(made: Imaged) -> bytes:
    """Errors of raw star samples and fused attitude over the pass, and when images were taken."""
    run = made.attitude.fused
    star, estimate = run.telemetry.star, run.estimate
    body = star.R_inertial_sensor * run.telemetry.mounting.rotation(star.heads[0]).inv()
    truth = made.scene.motion.R_inertial_body
    raw = (body.inv() * truth(star.times_s)).as_rotvec() / ARCSEC_RAD
    fused = estimate.error_rad(truth(estimate.times_s)) / ARCSEC_RAD
    sigma = 3.0 * estimate.sigma_rad / ARCSEC_RAD
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.2), layout="constrained")
        column = figure.subplots(3, 1, sharex=True)
        for k, (axes, name) in enumerate(zip(column, AXES, strict=True)):
            axes.plot(star.times_s, raw[:, k], ".", ms=1.5, color="#999999", label="star head 2")
            axes.fill_between(
                estimate.times_s, -sigma[:, k], sigma[:, k], color=COLOURS[1], alpha=0.25, lw=0,
                label="3 σ as stated",
            )  # fmt: skip
            axes.plot(estimate.times_s, fused[:, k], color=COLOURS[1], lw=0.9, label="fused")
            for image in made.scene.models:
                axes.axvspan(*made.scene.image_span_s(image), color=COLOURS[4], alpha=0.35, lw=0)
            axes.set_ylim(-15.0, 15.0)
            axes.set_ylabel(f"{name}, ″")
        column[0].legend(loc="upper right", ncols=3, fontsize=7)
        column[-1].set_xlabel("seconds from the pass over the field (images shaded)")
        return png(figure)
