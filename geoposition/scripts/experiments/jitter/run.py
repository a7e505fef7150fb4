"""The experiment from P's table of scenes to its two tables of accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from geoposition.scripts.experiments.jitter.accuracy import evaluate_all, write_lists
from geoposition.scripts.experiments.jitter.cases import FULL, QUICK, Case, Size, cases
from geoposition.scripts.experiments.jitter.chain import SceneResult, run_scene
from geoposition.scripts.experiments.jitter.ground import Ground, make_ground
from geoposition.scripts.experiments.jitter.outcome import Outcome, Scene
from geoposition.scripts.experiments.jitter.scene import Sighting, planned_model, sight
from geoposition.scripts.experiments.jitter.truth import attainable
from geoposition.scripts.results import Progress

DEFAULT_SEED: Final = 1
_TOTAL: Final = 1000
_GROUND: Final = 0.2
_SCENES: Final = 0.5
"""Shares of the work, for the progress bar; what is left is the matching."""


def run(
    folder: Path,
    progress: Progress,
    *,
    numbers: Sequence[int] = (),
    seed: int = DEFAULT_SEED,
    quick: bool = False,
) -> Outcome:
    """Make all files in `folder` and evaluate them; the same seed gives the same numbers."""
    return run_sized(folder, progress, cases(seed, numbers), seed, QUICK if quick else FULL)


def run_sized(
    folder: Path, progress: Progress, wanted: Sequence[Case], seed: int, size: Size
) -> Outcome:
    """Run the `wanted` cases, and the first of them with ZY-3's slow line, at some size."""

    def told(share: float) -> None:
        progress(round(_TOTAL * share), _TOTAL)

    every = [*wanted, wanted[0].with_slow_line()]
    grounds: dict[str, Ground] = {}
    fields = list(dict.fromkeys(case.field for case in every))
    for k, name in enumerate(fields):
        own = [case for case in wanted if case.field == name]
        models = [planned_model(case, size) for case in own]
        grounds[name] = make_ground(
            folder / "fields" / name, own, models, 10 * seed + _field_number(name)
        )
        told(_GROUND * (k + 1) / len(fields))
    results: list[SceneResult] = []
    for k, case in enumerate(every):
        seen: Sighting = sight(case, size)
        at, share = _GROUND + _SCENES * k / len(every), _SCENES / len(every)
        results.append(
            run_scene(
                seen,
                seen.true_model(),
                grounds[case.field],
                folder / case.name,
                lambda part, at=at, share=share: told(at + share * part),  # type: ignore[misc]
            )
        )
    write_lists(folder, every)
    begun = _GROUND + _SCENES
    found = evaluate_all(folder, lambda part: told(begun + (1.0 - begun) * part))
    joined = [
        Scene(result, before, after)
        for result, before, after in zip(results, found["before"], found["after"], strict=True)
    ]
    return Outcome(size, seed, tuple(joined[:-1]), joined[-1], attainable(results[0].told))


def _field_number(name: str) -> int:
    return sorted({case.field for case in cases(0)}).index(name)
