"""Both steady images of every scene against their field's orthophoto, as `evaluate` does it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from geoposition.calib_fields.evaluation import Evaluation
from geoposition.scripts.evaluate_run import evaluate_scene, write_results
from geoposition.scripts.evaluate_settings import Settings, scenes_of
from geoposition.scripts.experiments.jitter.cases import LINE_S, Case

STAGES: Final = ("before", "after")
"""Steady images with the on-board attitude (P table 1) and with the fused one (P table 2)."""

_SEARCH_M: Final = 20.0
"""P's absolute error is a few pixels; ZY-3's motion of 10 m is in the attitude on board."""
_SPACING_PX: Final = 88
"""Patches are 12 ms of the image apart: the on-board attitude's lines last 100 ms."""


def write_lists(folder: Path, cases: Sequence[Case]) -> None:
    """Write `before.toml` and `after.toml`: the lists that `evaluate` takes."""
    for stage in STAGES:
        parts = [
            f"[defaults]\nsearch_m = {_SEARCH_M}\nspacing_px = {_SPACING_PX}\n"
            f"line_period_s = {LINE_S!r}\n"
        ]
        for case in cases:
            known = case.published
            parts.append(
                f'[[scene]]\nname = "{case.name}"\nproduct = "{case.name}/{stage}/steady.tif"\n'
                f'field = "fields/{case.field}"\ndate = "{known.date}"\n'
                f'region = "{known.region}"\nside_swing_deg = {known.side_swing_deg}\n'
            )
        (folder / f"{stage}.toml").write_text("\n".join(parts), encoding="utf-8")


def evaluate_all(
    folder: Path, progress: Callable[[float], None]
) -> dict[str, tuple[Evaluation, ...]]:
    """Evaluate both lists; write the reports `evaluation-before` and `evaluation-after`."""
    found = {}
    for number, stage in enumerate(STAGES):
        listed = scenes_of(folder / f"{stage}.toml", Settings())
        results = []
        for k, scene in enumerate(listed):
            results.append(evaluate_scene(scene, lambda done, total: None))
            progress((number * len(listed) + k + 1) / (len(STAGES) * len(listed)))
        write_results(results, folder / f"evaluation-{stage}")
        found[stage] = tuple(result.evaluation for result in results)
    return found
