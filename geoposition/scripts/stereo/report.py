"""The HTML page about one stereo run: geometry, matches, residuals, heights, accuracy."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from geoposition.scripts.report import (
    Block,
    KeyFigure,
    Note,
    Report,
    Section,
    Table,
    number,
    provenance,
    render,
)
from geoposition.scripts.stereo.heights import height_blocks, statistics_cells
from geoposition.scripts.stereo.run import Options, StereoRun
from geoposition.scripts.stereo.sections import (
    bias_blocks,
    geometry_blocks,
    match_blocks,
    names_of,
    residual_blocks,
)
from geoposition.scripts.tables import whole_file

_AXES: Final = {"x": "X", "y": "Y", "z": "Z", "e": "east", "n": "north", "u": "up"}


def write(path: Path, page: str) -> None:
    """Write the page, whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def page(run: StereoRun, options: Options, source: str) -> str:
    """HTML of the run; `source` says where the ties come from."""
    return render(build(run, options, source))


def build(run: StereoRun, options: Options, source: str) -> Report:
    """Put the page's pieces together."""
    facts: Any = run.summary
    residual = facts["residual_px"]
    sections = [
        Section("Images and geometry", geometry_blocks(run)),
        Section("Matches", match_blocks(run)),
        Section("Relative bias", bias_blocks(run)),
        Section("Image residuals", residual_blocks(run)),
        Section("Heights", height_blocks(run)),
        Section("Stated accuracy", _accuracy(run)),
    ]
    if run.checks is not None:
        sections.append(Section("Check points", _checks(run)))
    return Report(
        title="Stereo intersection of " + ", ".join(names_of(run)),
        summary=(
            f"{facts['intersected']} of {facts['matches']} points seen in {len(run.products)} "
            f"images were intersected. Their lines of sight miss each other by "
            f"{_px(residual['median'])} px in the images (median), converge by "
            f"{number(facts['convergence_deg'], 1)}°, and the ground lies between "
            f"{number(facts['height_m']['min'], 0)} and {number(facts['height_m']['max'], 0)} m."
        ),
        key_figures=_keys(run),
        sections=sections,
        provenance=provenance(
            {
                "products": ", ".join(str(product.path) for product in run.products),
                "models": ", ".join(facts["models"]),
                "ties": source,
                "image points": f"sigma {number(facts['sigma_px'], 3)} px"
                + ("" if options.sigma_px is not None else ", from their scatter"),
                "relative bias": "removed" if options.remove_bias else "left in",
                "reference": (
                    "none" if run.differences is None else ", ".join(run.differences.provenance)
                ),
                "least convergence": f"{options.min_convergence_deg:g}°",
            }
        ),
    )


def _px(value: float | None) -> str:
    return "–" if value is None else number(value, 2)


def _keys(run: StereoRun) -> list[KeyFigure]:
    facts: Any = run.summary
    keys = [
        KeyFigure(str(facts["intersected"]), "", "points", f"of {facts['matches']} matches"),
        KeyFigure(_px(facts["residual_px"]["median"]), "px", "image residual, median",
                  f"95 % below {_px(facts['residual_px']['p95'])} px"),
        KeyFigure(number(facts["convergence_deg"], 1), "°", "convergence",
                  f"base to height {number(facts['base_to_height'], 2)}"),
    ]  # fmt: skip
    if run.checks is not None:
        found = run.checks.statistics
        keys.append(
            KeyFigure(number(found.rmse_3d_m, 2), "m", "RMSE in space at check points",
                      f"CE90 {number(found.ce90_m)} m, LE90 {number(found.le90_m)} m")
        )  # fmt: skip
    if run.differences is not None:
        off = run.differences.statistics
        keys.append(
            KeyFigure(number(off.median, 2, sign=True), "m", "height less reference, median",
                      f"NMAD {number(off.nmad)} m, {off.count} points")
        )  # fmt: skip
    return keys


def _accuracy(run: StereoRun) -> list[Block]:
    facts: Any = run.summary
    words = {"total": "all", "image_points": "image points", "models": "models"}
    rows = [
        (words[name], *(number(sigma[axis], 3) for axis in "enu"))
        for name, sigma in facts["sigma_enu_m"].items()
    ]
    stated = [
        f"{name}: " + (", ".join(_stated(key, value) for key, value in known.items()) or "nothing")
        for name, known in zip(names_of(run), facts["model_sigma"], strict=True)
    ]
    return [
        Table(
            "Standard deviations as stated, medians over the points, metres.",
            ("from", "east", "north", "up"),
            rows,
        ),
        Note(
            "Errors of the image points differ from point to point; those of the models, orbit "
            "and attitude, are common to neighbouring points and do not average out. Known of the "
            f"models: {'; '.join(stated)}. What is not stated is not in the sigmas."
        ),
    ]


def _stated(name: str, value: Any) -> str:
    words = {
        "attitude_arcsec": ("attitude", "″"),
        "orbit_m": ("orbit", "m"),
        "image_px": ("image", "px"),
        "ground_m": ("on the ground", "m"),
    }
    label, unit = words[name]
    numbers = value if isinstance(value, list) else [value]
    return f"{label} {' / '.join(number(one, 2) for one in numbers)} {unit}"


def _checks(run: StereoRun) -> list[Block]:
    assert run.checks is not None
    found = run.checks.statistics
    names = ("minimum", "maximum", "least", "most", "mean", "std", "rmse")
    rows = [(_AXES[name], *statistics_cells(found.axes[name], names)) for name in _AXES]
    return [
        Table(
            f"Errors of the intersected check points, found less true, metres; {found.e.count} "
            "points. |min| and |max| are the smallest and largest size.",
            ("axis", "minimum", "maximum", "|min|", "|max|", "mean", "std", "RMSE"),
            rows,
        ),
        Table(
            "In plan and in space, metres.",
            ("plan RMSE", "RMSE in space", "CE90", "LE90"),
            [(number(found.horizontal_rmse_m, 3), number(found.rmse_3d_m, 3),
              number(found.ce90_m, 3), number(found.le90_m, 3))],
            text_columns=0,
        ),
        Note("The check points took no part in anything: neither bias nor models follow them."),
    ]  # fmt: skip
