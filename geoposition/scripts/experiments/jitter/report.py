"""The experiment's page: P's tables and figures, ours beside them, and what the sensors allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from geoposition.scripts.experiments.jitter import figures, scene_parts
from geoposition.scripts.experiments.jitter.outcome import Outcome
from geoposition.scripts.report import (
    Block,
    Image,
    KeyFigure,
    Report,
    Section,
    Table,
    Text,
    number,
    provenance,
)

_GOALS: Final = {
    "truth_relative_px": "steady image against the truth, one shift a scene removed",
    "matched_relative_px": "steady image against the orthophoto, as measured",
    "mapping_px": "mapping with the true attitude, largest",
    "rpc_misfit_px": "RPC of the steady image, largest misfit",
}


def build(outcome: Outcome, result: Mapping[str, Any]) -> Report:
    """Put the page together; `result` is the outcome as JSON has it."""
    scenes = result["scenes"]
    first = outcome.scenes[0]
    before = [scene["relative_px_before"] for scene in scenes]
    after = [scene["relative_px_after"] for scene in scenes]
    truth = [scene["truth"]["after"]["relative_px"] for scene in scenes]
    return Report(
        "Jitter compensation over calibration fields",
        f"Simulated images ({len(scenes)}) of {outcome.size.lines} lines in "
        f"{2.0 * outcome.size.half_s:.2f} s at 490 km and 0.5 m, after P's scenes. With the "
        f"attitude made on board the steady images are right within themselves to "
        f"{_span(before)} px (P: 3.07 to 4.31), with stars and angular displacement fused to "
        f"{_span(after, 3)} px (P: 1.32 to 1.56, on real images).",
        [
            KeyFigure(_span(before), "px", "on-board attitude", "P table 1: 3.07 … 4.31"),
            KeyFigure(_span(after, 3), "px", "compensated", "P table 2: 1.32 … 1.56"),
            KeyFigure(_span(truth, 3), "px", "against the truth",
                      f"bound {number(outcome.bound.relative_px, 3)}, expected"),
            KeyFigure(f"{max(s['rpc_misfit_px']['after_max'] for s in scenes):.1g}", "px",
                      "RPC misfit, steady", _rpc_before(scenes)),
        ],
        [
            Section("Relative accuracy: P tables 1 and 2", _tables(result)),
            Section("Against the truth", _truth(outcome, result)),
            Section("Why the figures differ from P's", _reasons(outcome, result)),
            Section("Jitter: P figures 3 and 4", scene_parts.jitter_blocks(first, scenes[0])),
            Section("Fusion: P figures 5 to 7", scene_parts.fusion_blocks(first, scenes[0])),
            Section("Matches and residuals: P figures 8 and 9", scene_parts.match_blocks(outcome)),
            Section("Enter or leave the chain anywhere", scene_parts.commands_blocks(first)),
        ],
        provenance({"experiment": "jitter", "seed": outcome.seed, "image":
                    f"{outcome.size.lines} x {outcome.size.samples}",
                    "telemetry": f"{outcome.size.telemetry_s:g} s"}),
    )  # fmt: skip


def _span(values: Sequence[float], digits: int = 2) -> str:
    if len(values) == 1:
        return number(values[0], digits)
    return f"{number(min(values), digits)} … {number(max(values), digits)}"


def _rpc_before(scenes: Sequence[Mapping[str, Any]]) -> str:
    return f"as taken {number(max(s['rpc_misfit_px']['before_max'] for s in scenes), 2)}"


def _tables(result: Mapping[str, Any]) -> list[Block]:
    header = ("time", "swing, °", "region", "relative (P)", "V x", "V y", "M x (P)", "M y (P)",
              "truth")  # fmt: skip
    blocks: list[Block] = []
    titles = {
        "before": "P table 1: steady images with the on-board attitude, pixels.",
        "after": "P table 2: steady images with stars and angular displacement fused, pixels.",
    }
    for stage, title in titles.items():
        rows = []
        for scene in result["scenes"]:
            rows.append(
                (
                    scene["time"],
                    number(scene["side_swing_deg"], 3),
                    scene["region"],
                    _beside(scene, "relative_px", stage),
                    *(number(scene[f"{name}_{stage}"], 3) for name in ("v_x", "v_y")),
                    _beside(scene, "m_x", stage),
                    _beside(scene, "m_y", stage),
                    number(scene["truth"][stage]["relative_px"], 3),
                )
            )
        blocks.append(Table(title, header, rows, text_columns=1))
    blocks.append(
        Text(
            "P's own figures in brackets. x runs along the track, y across it. V is the mean over "
            "points held out of the fit, M the root mean square about one shift for the scene, "
            "the matching's own noise taken out; the relative accuracy is hypot(Mx, My). The last "
            "column is the same against the known truth, without any matching."
        )
    )
    rows = [
        (
            _GOALS[name],
            f"{goal['worst']:.2g}",
            f"{goal['goal']:g}",
            "yes" if goal["met"] else "no",
        )
        for name, goal in result["goals"].items()
    ]
    caption = "Goals: the worst of all scenes, and of the one with the 0.65 Hz line."
    blocks.append(Table(caption, ("figure", "px", "goal", "met"), rows))
    return blocks


def _beside(scene: Mapping[str, Any], name: str, stage: str) -> str:
    """Our figure, and P's in brackets."""
    ours, paper = (number(part[f"{name}_{stage}"], 3) for part in (scene, scene["paper"]))
    return f"{ours} ({paper})"


def _truth(outcome: Outcome, result: Mapping[str, Any]) -> list[Block]:
    rows = []
    for scene in (*result["scenes"], result["zy3"]):
        truth, absolute, rpc = scene["truth"], scene["absolute"], scene["rpc_misfit_px"]
        rows.append(
            (
                scene["name"],
                number(truth["before"]["relative_px"], 2),
                number(truth["after"]["m_x"], 3),
                number(truth["after"]["m_y"], 3),
                number(truth["after"]["relative_px"], 3),
                f"{truth['mapping_max_px']:.1g}",
                f"{number(absolute['line_px'], 2, sign=True)} ± "
                f"{number(absolute['sigma_line_px'], 2)}",
                f"{number(absolute['sample_px'], 2, sign=True)} ± "
                f"{number(absolute['sigma_sample_px'], 2)}",
                number(rpc["before_max"], 2),
                f"{rpc['after_max']:.1g}",
            )
        )
    header = ("scene", "on board", "along", "across", "both", "mapping", "Δ line", "Δ sample",
              "RPC before", "after")  # fmt: skip
    bound = outcome.bound
    return [
        Table(
            "Error of the steady images against the truth, pixels: RMS about one shift for the "
            "scene; largest error of the mapping with the true attitude; the shift itself with "
            "the standard deviation that the fused covariance gives; largest misfit of an RPC.",
            header,
            rows,
        ),
        Text(
            f"What the telemetry allows at best: {number(bound.relative_px, 3)} px expected (RMS "
            f"in two dimensions), from the sensor's random walk and its drift; one scene scatters "
            f"about it, 95 of 100 stay below {number(bound.relative_95_px, 3)} px and "
            f"{number(100.0 * bound.share_above, 0)} of 100 exceed 0.10 px, with whatever "
            f"estimator. The shift is star noise: ± {number(bound.absolute_px, 2)} px per axis, "
            f"which a relative figure does not hold."
        ),
        Image(
            figures.profiles(outcome.scenes, "before"),
            "On-board attitude: error along each image, about its mean. Line: against the truth; "
            "dots: residuals of the matches with the orthophoto.",
            "Error along the lines, one row of two panels for each scene.",
        ),
        Image(
            figures.profiles(outcome.scenes, "after"),
            "Compensated: the same. What is left is the sensor's random walk.",
            "Error along the lines, one row of two panels for each scene.",
        ),
    ]


def _reasons(outcome: Outcome, result: Mapping[str, Any]) -> list[Block]:
    expected = result["bound"]["before_px"]
    return [
        Text(
            f"Table 1: the on-board attitude is white noise at 10 Hz of 0.75″ in pitch and 0.5″ "
            f"in roll, linear between its samples, chosen so that P's 3 to 4 px come about: "
            f"{number(expected, 2)} px are expected of an image of "
            f"{2.0 * outcome.size.half_s:.2f} s. The jitter alone is 0.2 px. What jitter does "
            "within a patch of 64 m, 9 ms, the match does not see."
        ),
        Text(
            "Table 2: P's 1.3 to 1.6 px are of real images. They hold the matching between images "
            "of different seasons and sensors, the error of orthophoto and DEM, the camera's "
            "calibration and what the instruments did beside their noise. Here reference and "
            "camera are exact and the noise is white, so that what is left is the sensor's random "
            "walk over the image: the share of the attitude in P's figure."
        ),
    ]
