"""An adjustment run: RUN.toml in, a folder with models, tables, figures and report out."""

from __future__ import annotations

import json
from pathlib import Path
from time import perf_counter

from geoposition.scripts.adjust.facts import facts_of
from geoposition.scripts.adjust.files import write_models, write_points
from geoposition.scripts.adjust.images import open_images
from geoposition.scripts.adjust.input import read_run
from geoposition.scripts.adjust.plan import Layout, planned
from geoposition.scripts.adjust.points import read_points
from geoposition.scripts.adjust.request import RunInput
from geoposition.scripts.adjust.solve import RunResult, solved
from geoposition.scripts.adjust.unknowns import (
    TIES_ALONE,
    Priors,
    blocks_of,
    held_without_control,
)
from geoposition.scripts.results import Progress, plain
from geoposition.scripts.scratch import made_in, publish_folder, require_folder, scratch_beside


def run(path: Path, output: Path, progress: Progress) -> dict[str, object]:
    """Make everything in a folder beside `output`, then put it in its place; facts for JSON."""
    require_folder(output)
    request = read_run(path)
    begin = perf_counter()
    images = open_images(request.images, path)
    if request.control is None and request.plan is None:
        images = held_without_control(images)
    alone = request.control is None and request.heights is None and request.plan is None
    blocks = blocks_of(images, request.unknowns, TIES_ALONE if alone else Priors())
    layout = None
    if request.plan is not None:
        layout = planned(request, tuple(image.model for image in images), blocks)
    result = None
    if request.control is not None or request.ties is not None:
        points = read_points(request, images, progress)
        result = solved(request, images, blocks, points, progress)
    summary: dict[str, object] = {} if result is None else facts_of(result)
    if layout is not None:
        summary["plan"] = layout.as_dict()
    summary["seconds"] = round(perf_counter() - begin, 2)
    with scratch_beside(output) as scratch:
        _fill(scratch, output, request, result, layout, summary)
        publish_folder(scratch, output, last="adjustment.json")
    return summary | {"output": str(output)}


def _fill(
    folder: Path,
    home: Path,
    request: RunInput,
    result: RunResult | None,
    layout: Layout | None,
    summary: dict[str, object],
) -> None:
    """Write all files, later moved `home`, into `folder`, and their names into `summary`."""
    if result is not None:
        write_points(result, folder)
        if request.output.models:
            models = result.adjustment.models
            summary["models"] = write_models(result.images, models, request.output, folder, home)
    if request.output.report:
        from geoposition.scripts.adjust.report import page

        text = page(request, result, layout, summary)
        (folder / "report.html").write_text(text, encoding="utf-8")
    summary["files"] = [*made_in(folder), "adjustment.json"]
    text = json.dumps(plain(summary), ensure_ascii=False, allow_nan=False, indent=1)
    (folder / "adjustment.json").write_text(text + "\n", encoding="utf-8")
