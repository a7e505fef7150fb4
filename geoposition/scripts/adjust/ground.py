"""Report pieces about ground points: the tables of errors, predicted beside measured, vectors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from geoposition.accuracy import PointStatistics
from geoposition.adjust import PointResults
from geoposition.observations import ControlPoints
from geoposition.scripts.adjust.facts import (
    kept,
    predicted_enu_m,
    seen_once,
    statistics_of,
)
from geoposition.scripts.adjust.figures import ground_vectors
from geoposition.scripts.adjust.solve import RunResult
from geoposition.scripts.report import Block, Image, Note, Table, Text, number

_AXES: Final = {"x": "X", "y": "Y", "z": "Z", "e": "east", "n": "north", "u": "up"}
_MOST_ROWS: Final = 100


def ground_blocks(result: RunResult, facts: Mapping[str, Any]) -> list[Block]:
    """Tables and figures of control and check points, and of those left out in turn."""
    done = result.adjustment
    blocks: list[Block] = []
    for word, points, given in (
        ("control", done.control, result.points.control),
        ("check", done.check, result.points.check),
    ):
        if given is not None:
            blocks += _role(word, points, given)
    if facts["leave_one_out"] is not None:
        blocks.append(_left_out(facts["leave_one_out"]))
    if not blocks:
        blocks.append(
            Text("No ground points: only the images' agreement with each other was adjusted.")
        )
    return blocks


def _role(word: str, points: PointResults, given: ControlPoints) -> list[Block]:
    before, after = statistics_of(points, given, before=True), statistics_of(points, given)
    if after is None:
        return [Text(f"None of the {word} points came out.")]
    single = int(np.sum(seen_once(points) & kept(points)))
    blocks: list[Block] = [_table(word, before, after)]
    if single:
        blocks.append(
            Note(f"{single} of the {word} points are seen in one image only: they keep their "
                 "given height, so nothing is said of it.")
        )  # fmt: skip
    blocks.append(_predicted(word, points, given))
    png = ground_vectors(points, given)
    if png is not None:
        blocks.append(
            Image(
                png,
                f"Errors of {word} points on the ground, intersected less given, before and after, "
                "magnified: the key arrow of each panel gives its scale in metres.",
                f"Two panels of arrows: errors of {word} points before and after.",
            )
        )
    return blocks


def _table(word: str, before: PointStatistics | None, after: PointStatistics) -> Table:
    """Return RMSE and extremes by axis as the thesis's tables 5.2 to 5.4 have them."""
    rows, strong = [], []
    for when, found in (("before", before), ("after", after)):
        if found is None:
            continue
        for name, axis in found.axes.items():
            rows.append(
                (when, _AXES[name], number(axis.minimum, 3, sign=True),
                 number(axis.maximum, 3, sign=True), number(axis.mean, 3, sign=True),
                 number(axis.rmse, 3))
            )  # fmt: skip
        for name, value in (
            ("CE90", found.ce90_m), ("LE90", found.le90_m), ("in space", found.rmse_3d_m),
        ):  # fmt: skip
            if when == "after" and name == "in space":
                strong.append(len(rows))
            rows.append((when, name, "–", "–", "–", number(value, 3)))
    return Table(
        f"Errors of {after.e.count} {word} points, intersected less given, metres: geocentric "
        "X, Y, Z, then east, north, up; radius and height that hold 90 %, and RMSE in space.",
        ("", "axis", "min", "max", "mean", "RMSE or 90 %"),
        rows,
        text_columns=2,
        strong=strong,
    )


def _predicted(word: str, points: PointResults, given: ControlPoints) -> Table:
    predicted, measured = predicted_enu_m(points, given), points.rmse_enu_m()
    rows = [
        (axis, number(float(p), 3), number(float(m), 3), number(float(m / p), 2))
        for axis, p, m in zip(("east", "north", "up"), predicted, measured, strict=True)
    ]
    note = (
        " Control took part in the adjustment, so it fits better than predicted."
        if word == "control"
        else ""
    )
    return Table(
        f"Predicted and measured RMSE of {word} points, metres; 1 where the covariances are "
        f"true.{note}",
        ("axis", "predicted", "measured", "measured / predicted"),
        rows,
    )


def _left_out(facts: Mapping[str, Any]) -> Table:
    errors = {entry["id"]: entry for entry in facts["errors_m"]}
    rows = []
    for entry in facts["points"][:_MOST_ROWS]:
        ground = errors[entry["id"]]
        rows.append(
            (entry["id"], entry["image"], number(entry["row"], 3, sign=True),
             number(entry["col"], 3, sign=True),
             *(number(ground[axis], 3, sign=True) for axis in "enu"))
        )  # fmt: skip
    return Table(
        "Each control point predicted by all others (leave one out): residual in the image, "
        "pixels, and error on the ground, metres.",
        ("point", "image", "row", "col", "east", "north", "up"),
        rows,
        text_columns=2,
    )
