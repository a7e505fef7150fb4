"""What the experiment found, as numbers: the contract's `scenes`, and P's tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from geoposition.calib_fields.catalog import PublishedScene
from geoposition.calib_fields.evaluation import Evaluation
from geoposition.scripts.experiments.jitter.cases import IFOV_RAD, PIXEL_M, Size
from geoposition.scripts.experiments.jitter.chain import SceneResult
from geoposition.scripts.experiments.jitter.truth import GOAL_PX, Bound, TrueError
from geoposition.sensors.attitude_determination.jitter.lines import AXES
from geoposition.sensors.jitter_scene import JitterSceneOptions

MATCH_GOAL_PX: Final = 0.15
MAPPING_GOAL_PX: Final = 0.01
RPC_GOAL_PX: Final = 0.002
_ARCSEC_RAD: Final = float(np.pi / 648000.0)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One scene: the chain's result, and both evaluations of its steady images."""

    chain: SceneResult
    before: Evaluation
    after: Evaluation


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """All scenes of P; `slow` is the first one again with ZY-3's line at 0.65 Hz on top."""

    size: Size
    seed: int
    scenes: tuple[Scene, ...]
    slow: Scene
    bound: Bound

    def as_json(self) -> dict[str, object]:
        """Return what `--json` prints; nothing in it depends on the clock."""
        scenes = [scene_facts(scene, self.bound) for scene in self.scenes]
        slow = scene_facts(self.slow, self.bound)
        return {
            "scenes": scenes,
            "zy3": slow,
            "bound": {
                "relative_px": self.bound.relative_px,
                "relative_95_px": self.bound.relative_95_px,
                "share_above_goal": self.bound.share_above,
                "absolute_px": self.bound.absolute_px,
                "before_px": expected_before_px(self.scenes[0].chain, self.size),
            },
            "goals": goals(scenes, slow),
            "tables": {"1": table(scenes, "before"), "2": table(scenes, "after")},
            "lines": self.size.lines,
            "samples": self.size.samples,
            "telemetry_s": self.size.telemetry_s,
            "seed": self.seed,
        }


def scene_facts(scene: Scene, bound: Bound) -> dict[str, Any]:
    """Numbers of one scene; x is along the track, y across it, pixels of the image."""
    chain, known = scene.chain, scene.chain.case.published
    facts: dict[str, Any] = {
        "time": known.date,
        "side_swing_deg": known.side_swing_deg,
        "region": known.region,
        "name": chain.case.name,
        "epoch_utc": chain.case.epoch_utc,
    }
    for stage, found in (("before", scene.before), ("after", scene.after)):
        for name in ("relative_px", "v_x", "v_y", "m_x", "m_y"):
            estimate = found.estimates[name]
            facts[f"{name}_{stage}"] = estimate.value
            facts[f"{name}_{stage}_interval"] = list(estimate.interval)
        facts[f"relative_px_{stage}_as_measured"] = found.raw["relative_px"]
        facts[f"points_{stage}"] = found.points
        facts[f"patches_{stage}"] = len(found.matches.cause)
        for axis in "en":
            estimate = found.estimates[f"bias_{axis}_m"]
            facts[f"bias_{axis}_m_{stage}"] = estimate.value
            facts[f"bias_{axis}_m_{stage}_interval"] = list(estimate.interval)
    facts["paper"] = _published(known)
    facts["truth"] = {
        "before": _against_truth(chain.error_before),
        "after": _against_truth(chain.error_after),
        "mapping_rms_px": chain.mapping_error.relative_px,
        "mapping_max_px": float(np.nanmax(np.abs(chain.mapping_error.error_px))),
        "bound_px": bound.relative_px,
    }
    facts["absolute"] = _absolute(chain)
    facts["jitter"] = _jitter(chain)
    facts["rpc_misfit_px"] = _misfits(chain)
    facts["filter"] = _filter(chain)
    return facts


def _published(known: PublishedScene) -> dict[str, float]:
    """P's own figures, named as ours."""
    stages = {
        "before": (known.onboard_px, known.onboard_mean_px, known.onboard_rms_px),
        "after": (known.compensated_px, known.mean_px, known.rms_px),
    }
    facts: dict[str, float] = {}
    for stage, (relative, mean, rms) in stages.items():
        values = dict(zip(("v_x", "v_y", "m_x", "m_y"), (*mean, *rms), strict=True))
        facts |= {f"{name}_{stage}": v for name, v in {"relative_px": relative, **values}.items()}
    return facts


def _against_truth(error: TrueError) -> dict[str, float]:
    x, y = error.rms_px.tolist()
    return {"relative_px": error.relative_px, "m_x": x, "m_y": y}


def _absolute(chain: SceneResult) -> dict[str, float]:
    """Shift of the scene, and what the fused attitude's covariance says of it."""
    line, sample = chain.error_after.mean_px.tolist()
    roll, pitch, _ = (chain.fused_sigma_rad / IFOV_RAD).tolist()
    return {
        "line_px": line,
        "sample_px": sample,
        "sigma_line_px": pitch,
        "sigma_sample_px": roll,
        "size_m": PIXEL_M * float(np.hypot(line, sample)),
    }


def _jitter(chain: SceneResult) -> dict[str, object]:
    found = chain.jitter
    return {
        "axes": {axis: [dict(peak.summary()) for peak in found.axes[axis]] for axis in AXES},
        "true_arcsec": {
            axis: {f"{line.frequency_hz:g}": line.amplitude_arcsec[k] for line in chain.case.lines}
            for k, axis in enumerate(AXES)
        },
        "peak_arcsec": dict(zip(AXES, (chain.peak_rad / _ARCSEC_RAD).tolist(), strict=True)),
    }


def _misfits(chain: SceneResult) -> dict[str, object]:
    """Largest and RMS misfit of an RPC: of the image as taken and of the steady one."""
    misfit = chain.after["rpc_misfit_px"]
    out: dict[str, object] = {}
    for stage in ("before", "after"):
        part = misfit[stage]
        if part is not None:
            out[f"{stage}_max"] = max(abs(part[axis]["max"]) for axis in ("row", "col"))
            out[f"{stage}_rms"] = float(np.hypot(part["row"]["rms"], part["col"]["rms"]))
    return out


def _filter(chain: SceneResult) -> dict[str, object]:
    course = chain.course
    deg_h = np.degrees(1.0) * 3600.0
    normal = course.error_rad / course.sigma_rad
    return {
        "rms_arcsec": (np.sqrt(np.mean(course.error_rad**2, axis=0)) / _ARCSEC_RAD).tolist(),
        "sigma_arcsec": (np.mean(course.sigma_rad, axis=0) / _ARCSEC_RAD).tolist(),
        "normalised_rms": float(np.sqrt(np.mean(normal**2))),
        "drift_deg_h": (course.drift_rad_s[-1] * deg_h).tolist(),
        "drift_sigma_deg_h": (course.drift_sigma_rad_s[-1] * deg_h).tolist(),
        "true_drift_deg_h": (course.true_drift_rad_s * deg_h).tolist(),
    }


def expected_before_px(chain: SceneResult, size: Size) -> float:
    """Root of the expected square of the relative error that the on-board attitude leaves.

    White noise at the knots of a line from knot to knot: two thirds of its variance in the mean
    over time, less the variance of the image's mean; the jitter's own comes on top.
    """
    options = JitterSceneOptions()
    roll, pitch, _ = np.square(options.onboard_noise_arcsec)
    knots = max(2.0 * size.half_s * options.onboard_hz, 1.0)
    noise = (roll + pitch) * max(2.0 / 3.0 - 1.0 / knots, 0.0)
    quick = [line for line in chain.case.lines if line.frequency_hz > options.onboard_hz]
    shaken = sum(0.5 * (a**2 + b**2) for a, b, _ in (line.amplitude_arcsec for line in quick))
    return float(np.sqrt(noise + shaken) * _ARCSEC_RAD / IFOV_RAD)


def goals(scenes: list[dict[str, Any]], slow: Mapping[str, Any]) -> dict[str, object]:
    """Say for each goal the worst figure, over all scenes with and without the slow line."""
    every = [*scenes, slow]
    worst = {
        "truth_relative_px": (max(s["truth"]["after"]["relative_px"] for s in every), GOAL_PX),
        "matched_relative_px": (
            max(s["relative_px_after_as_measured"] for s in every), MATCH_GOAL_PX),
        "mapping_px": (max(s["truth"]["mapping_max_px"] for s in every), MAPPING_GOAL_PX),
        "rpc_misfit_px": (max(s["rpc_misfit_px"]["after_max"] for s in every), RPC_GOAL_PX),
    }  # fmt: skip
    return {
        name: {"worst": value, "goal": goal, "met": bool(value <= goal)}
        for name, (value, goal) in worst.items()
    }


def table(scenes: list[dict[str, Any]], stage: str) -> list[dict[str, object]]:
    """Rows of P table 1 (`before`) or 2 (`after`), P's own relative accuracy beside ours."""
    return [
        {
            "time": scene["time"],
            "side_swing_deg": scene["side_swing_deg"],
            "region": scene["region"],
            "relative_px": scene[f"relative_px_{stage}"],
            **{name: scene[f"{name}_{stage}"] for name in ("v_x", "v_y", "m_x", "m_y")},
            "paper_relative_px": scene["paper"][f"relative_px_{stage}"],
            "truth_px": scene["truth"][stage]["relative_px"],
        }
        for scene in scenes
    ]
