"""Control, check and tie points of an adjustment run, from its files or its images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geoposition.adjust import selected_control
from geoposition.arrays import BoolArray, FloatArray
from geoposition.errors import ArgumentError, ProductError
from geoposition.matching import match_images
from geoposition.observations import ControlPoints, TiePoints
from geoposition.scripts.adjust.images import RunImage, names_of
from geoposition.scripts.adjust.request import CheckInput, PointsInput, RunInput, TiesInput
from geoposition.scripts.control_files import (
    Heights,
    ImageTable,
    covariance_enu_m2,
    geodetic_of,
    read_control_file,
)
from geoposition.scripts.image_names import ImageNames
from geoposition.scripts.product_images import image_of
from geoposition.scripts.results import Progress
from geoposition.scripts.tie_tables import read_named_ties


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """What was measured; None where there is none."""

    control: ControlPoints | None
    check: ControlPoints | None
    ties: TiePoints | None


def read_points(run: RunInput, images: Sequence[RunImage], progress: Progress) -> Points:
    """Read or match all points and tell control, check and ties apart."""
    names = names_of(images)
    ties = None if run.ties is None else _ties(run.ties, images, names, run, progress)
    if run.control is None:
        if run.check.file is not None:
            raise ProductError(run.path, "[check] file", "a [control] beside it expected")
        return Points(None, None, ties)
    control, marks, taken = _points(run.control, names, ties)
    check = None
    if run.check.file is not None:
        check, _, more = _points(_check_points(run.check, run.control), names, ties)
        taken |= more
        control = _without(control, check, run)
    else:
        check_mask = _check_mask(run, control, marks)
        if check_mask.all():
            raise ProductError(run.path, "[check]", "some points left as control expected")
        if check_mask.any():
            control, check = (
                selected_control(control, ~check_mask), selected_control(control, check_mask),
            )  # fmt: skip
    if ties is not None and taken:
        rest = ties.selected(~np.isin(ties.ids.astype(np.str_), sorted(taken)))
        ties = rest if len(rest) else None
    return Points(control, check, ties)


def _ties(
    given: TiesInput,
    images: Sequence[RunImage],
    names: ImageNames,
    run: RunInput,
    progress: Progress,
) -> TiePoints:
    if given.match:
        if len(images) < 2:
            raise ProductError(run.path, "[ties] match", "two or more images expected")
        sources = [image_of(image.product, image.pixels) for image in images]
        return match_images(sources, [image.model for image in images], progress=progress)
    pair = None
    if given.images is not None:
        first, second = (names.number_of(run.path, name) for name in given.images)
        if first == second:
            raise ProductError(run.path, "[ties] images", "two different images expected")
        pair = (first, second)
    parts = [read_named_ties(file, names, pair) for file in given.files]
    if len(parts) == 1:
        return parts[0]
    # The same number in two files is not the same point where ids only count.
    ids = np.concatenate(
        [
            part.ids.astype(np.str_)
            if part.ids.dtype.kind == "U"
            else np.array([f"{k}:{i}" for i in part.ids.tolist()], dtype=np.str_)
            for k, part in enumerate(parts)
        ]
    )
    try:
        return TiePoints(
            ids,
            np.concatenate([part.product for part in parts]),
            np.concatenate([part.image_px for part in parts]),
        )
    except ArgumentError as error:
        raise ProductError(given.files[-1], "", str(error)) from None


def _points(
    given: PointsInput, names: ImageNames, ties: TiePoints | None
) -> tuple[ControlPoints, BoolArray, set[str]]:
    """Points with image points, which the file itself calls check, and ids taken from the ties."""
    found = read_control_file(given.file, given.crs)
    if found.ground is None:
        raise ProductError(
            given.file, "header", "column(s) id, lon, lat, height expected: ground positions"
        )
    ground = found.ground
    geodetic = geodetic_of(ground, Heights(given.geoid, given.dem, given.dem_geoid))
    covariance = covariance_enu_m2(ground, geodetic, given.sigma_m)
    table = found.image
    if given.image_points is not None:
        table = read_control_file(given.image_points).image
        if table is None:
            raise ProductError(
                given.image_points, "header", "column(s) id, product, row, col expected"
            )
        # The table may hold ties and check points too, some in images that are not adjusted.
        table = table.of(ground.ids)
        if not len(table):
            expected = f"image points of the points in {given.file} expected, there are none"
            raise ProductError(given.image_points, "id", expected)
    taken: set[str] = set()
    if table is not None:
        image = _image_points(table, names, given.image_sigma_px)
    elif ties is not None:
        rows = np.isin(ties.ids.astype(np.str_), ground.ids)
        taken = set(ground.ids.tolist())
        some = ties.selected(rows)
        image = TiePoints(some.ids.astype(np.str_), some.product, some.image_px)
    else:
        raise ProductError(
            given.file, "header",
            "columns product, row, col, or another table of image points (image_points), expected",
        )  # fmt: skip
    if not len(image):
        raise ProductError(given.file, "", "image points of its points expected, there are none")
    try:
        return ControlPoints(ground.ids, geodetic, covariance, image), ground.is_check, taken
    except ArgumentError as error:
        raise ProductError(given.image_points or given.file, "", str(error)) from None


def _image_points(table: ImageTable, names: ImageNames, sigma_px: float) -> TiePoints:
    """Image points; a covariance only where the table has standard deviations of its own."""
    blank = np.flatnonzero(np.strings.str_len(table.names) == 0)
    if len(blank) and len(names.files) > 1:
        raise ProductError(
            table.path, f"point {table.ids[blank[0]]}", "a column product that names its image "
            "expected: there are several images",
        )  # fmt: skip
    spoken = table.names
    if len(names.files) == 1 and table.path.suffix.lower() == ".points":
        # The name is only that of the file, and there is only one image it can mean.
        spoken = np.full(len(table), "")
    product = names.numbers_of(table.path, spoken)
    covariance = None
    known = np.isfinite(table.sigma_px)
    if np.any(known):
        bad = np.flatnonzero(np.any(known & (table.sigma_px <= 0.0), axis=1))
        if len(bad):
            raise ProductError(
                table.path, f"point {table.ids[bad[0]]}", "positive sigmas in pixels expected"
            )
        sigma: FloatArray = np.where(known, table.sigma_px, sigma_px)
        covariance = np.zeros((len(table), 2, 2))
        covariance[:, [0, 1], [0, 1]] = sigma**2
    # A row without numbers was not measured; a pair of words is a mistake, flagged later.
    there = np.flatnonzero(~np.isnan(table.image_px).all(axis=1))
    try:
        return TiePoints(table.ids, product, table.image_px, covariance).selected(there)
    except ArgumentError as error:
        raise ProductError(table.path, "", str(error)) from None


def _check_points(check: CheckInput, control: PointsInput) -> PointsInput:
    """Check points are as the control in all but their files."""
    assert check.file is not None
    return PointsInput(
        file=check.file,
        image_points=check.image_points or control.image_points,
        sigma_m=control.sigma_m,
        image_sigma_px=control.image_sigma_px,
        crs=control.crs,
        geoid=control.geoid,
        dem=control.dem,
        dem_geoid=control.dem_geoid,
    )


def _without(control: ControlPoints, check: ControlPoints, run: RunInput) -> ControlPoints:
    both = np.isin(control.ids, check.ids)
    if both.all():
        raise ProductError(run.path, "[check] file", "points that are not control too expected")
    return selected_control(control, ~both) if both.any() else control


def _check_mask(run: RunInput, control: ControlPoints, marks: BoolArray) -> NDArray[np.bool_]:
    """Points that are kept out; without [check] those that the file itself marks."""
    given, n = run.check, len(control)
    if given.ids:
        unknown = [name for name in given.ids if name not in set(control.ids.tolist())]
        if unknown:
            raise ProductError(
                run.path, "[check] ids", f"{unknown[0]!r} is no point of {run.control_file}"
            )
        return np.isin(control.ids, given.ids)
    if given.every is not None:
        return np.asarray(np.arange(n) % given.every == given.every - 1)
    if given.fraction is not None:
        mask = np.zeros(n, dtype=bool)
        count = min(max(round(given.fraction * n), 1), n - 1)
        mask[np.floor((np.arange(count) + 0.5) * n / count).astype(np.int64)] = True
        return mask
    return np.asarray(marks)
