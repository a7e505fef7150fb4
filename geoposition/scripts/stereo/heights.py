"""The stereo report's heights: the map, and the differences from a reference and their causes."""

from __future__ import annotations

from geoposition.accuracy import AxisStatistics
from geoposition.scripts import figures
from geoposition.scripts.report import Block, Image, Table, number
from geoposition.scripts.stereo import figures as stereo_figures
from geoposition.scripts.stereo.checks import HeightDifferences
from geoposition.scripts.stereo.run import StereoRun
from geoposition.scripts.stereo.sections import degrees_of, found_rows
from geoposition.surface import Comparison

_STATISTICS = ("minimum", "maximum", "mean", "median", "rmse", "nmad")


def height_blocks(run: StereoRun) -> list[Block]:
    """Return the map of heights and, where there is a reference, what differs from it."""
    good, degrees = found_rows(run), degrees_of(run)
    terrain = stereo_figures.gridded(degrees, run.points.geodetic[good, 2])
    if run.differences is None:
        return [
            Image(
                stereo_figures.height_maps(terrain, {}),
                "Heights of the intersected points, means of cells, metres.",
                "Map of heights",
            )
        ]
    off = run.differences.difference_m[good]
    maps = {"Less the reference": stereo_figures.gridded(degrees, off)}
    return [
        Image(
            stereo_figures.height_maps(terrain, maps),
            "Heights of the intersected points, means of cells, and their difference from the "
            "reference, metres.",
            "Maps of heights and of differences",
        ),
        *_differences(run.differences),
        Image(
            figures.histograms(
                {"height": run.differences.difference_m}, unit="height found less reference, m"
            ),
            "Distribution of the height differences, metres.",
            "A histogram",
        ),
    ]


def statistics_cells(axis: AxisStatistics, names: tuple[str, ...]) -> list[str]:
    """Return the named statistics of one axis, as a table shows them."""
    signed = {"minimum", "maximum", "mean", "median"}
    return [number(getattr(axis, name), 3, sign=name in signed) for name in names]


def _differences(found: HeightDifferences) -> list[Block]:
    rows = [_row("as found", found.statistics)]
    blocks: list[Block] = []
    if found.comparison is not None:
        if found.comparison.after is not None:
            rows.append(_row("co-registered", found.comparison.after))
        blocks = [_shift(found.comparison), _classes(found.comparison)]
    title = "Height found less the reference's at the same place, metres."
    head = ("", "points", "minimum", "maximum", "mean", "median", "RMSE", "NMAD")
    return [Table(title, head, rows), *blocks]


def _row(name: str, axis: AxisStatistics) -> tuple[str, ...]:
    return (name, str(axis.count), *statistics_cells(axis, _STATISTICS))


def _shift(found: Comparison) -> Table:
    """Where the reference would have to move to for the differences to be least."""
    title = (
        "Shift of the points against the reference (east, north, up) by which the differences "
        "vanish, and tilt of the differences."
    )
    head = ("east, m", "north, m", "up, m", "tilt, mm/m", "rises towards, °")
    tilt = (number(found.tilt_mm_per_m, 2), number(found.tilt_azimuth_deg, 0))
    if found.shift is None:
        return Table(title, head, [("ground too flat, or too little", "", "", *tilt)])
    both = zip(found.shift.enu_m, found.shift.sigma_enu_m, strict=True)
    cells = [f"{number(value, 2, sign=True)} ± {number(sigma, 2)}" for value, sigma in both]
    return Table(title, head, [(*cells, *tilt)])


def _classes(found: Comparison) -> Table:
    """Return differences by the ground's slope, and by where it falls to."""
    parts = [(f"slope {part.name}°", part) for part in found.by_slope]
    parts += [(f"falls {part.name}", part) for part in found.by_aspect]
    return Table(
        "Differences by slope and aspect of the reference's ground, metres.",
        ("ground", "points", "median", "NMAD"),
        [
            (name, str(part.count), number(part.median_m, 2, sign=True), number(part.nmad_m, 2))
            for name, part in parts
            if part.count
        ],
    )
