"""Both steady images of every scene against their field's orthophoto, as `evaluate` does it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from geoposition.scripts.evaluate.run import SceneResult, evaluate_scene, write_results
from geoposition.scripts.evaluate.settings import ListedScene, Settings, scenes_of
from geoposition.scripts.experiments.jitter.cases import LINE_S, Case
from geoposition.scripts.results import unseen

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


def listed_scenes(folder: Path, number: int) -> dict[str, ListedScene]:
    """Return the scene of that place in the lists, by stage."""
    return {stage: scenes_of(folder / f"{stage}.toml", Settings())[number] for stage in STAGES}


def evaluated(scenes: Mapping[str, ListedScene]) -> dict[str, SceneResult]:
    """Match and evaluate both steady images of a scene."""
    return {stage: evaluate_scene(scene, unseen) for stage, scene in scenes.items()}


def write_reports(folder: Path, found: Sequence[Mapping[str, SceneResult]]) -> None:
    """Write `evaluation-before` and `evaluation-after`, all scenes in each."""
    for stage in STAGES:
        write_results([scene[stage] for scene in found], folder / f"evaluation-{stage}")
