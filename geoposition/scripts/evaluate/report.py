"""The accuracy report of one scene or of several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from geoposition.calib_fields.evaluate import Evaluation
from geoposition.calib_fields.intervals import Estimate
from geoposition.scripts.evaluate.sections import REMOVED, scene_blocks
from geoposition.scripts.report import (
    Block,
    KeyFigure,
    Note,
    Report,
    Section,
    Table,
    Text,
    number,
    provenance,
)
from geoposition.scripts.scene_coverage import coverage

if TYPE_CHECKING:
    from geoposition.scripts.evaluate.run import SceneResult


def build_report(results: Sequence[SceneResult], inputs: Mapping[str, str]) -> Report:
    """Report of `results`; `inputs` are the files and their checksums."""
    first = results[0].evaluation
    several = len(results) > 1
    names = [str(result.facts.get("name", k + 1)) for k, result in enumerate(results)]
    sections = [Section("Accuracy", _tables(results, names))]
    for name, result in zip(names, results, strict=True):
        sections.append(Section(name if several else "The scene", scene_blocks(result)))
    sections.append(Section("How to read the numbers", _method(first)))
    facts: dict[str, object] = {f"input {Path(name).name}": sums for name, sums in inputs.items()}
    facts["options"] = "; ".join(
        f"{name}: {_options(result)}" for name, result in zip(names, results, strict=True)
    )
    if several:
        title = f"Geometric accuracy of {len(results)} images"
        sizes = [result.evaluation.estimates["relative_px"].value for result in results]
        summary = (
            f"{len(results)} images matched with reference orthophotos. Relative accuracy after "
            f"removing {REMOVED[first.options.relative]}: {number(min(sizes))} to "
            f"{number(max(sizes))} px."
        )
    else:
        title, summary = f"Geometric accuracy of {names[0]}", _summary(first)
    keys = () if several else _keys(first)
    return Report(title, summary, keys, sections, provenance(facts))


def _summary(found: Evaluation) -> str:
    e, n = found.estimates["bias_e_m"], found.estimates["bias_n_m"]
    relative = found.estimates["relative_px"]
    return (
        f"{found.points} of {len(found.matches.cause)} patches match the reference orthophoto, "
        f"in {number(100.0 * coverage(found.matches), 0)} % of the overlap. "
        f"The image comes onto it by a shift of {number(e.value, 2, sign=True)} m east and "
        f"{number(n.value, 2, sign=True)} m north. Within itself, after removing "
        f"{REMOVED[found.options.relative]}, it is right to {number(relative.value)} px "
        f"({number(relative.interval[0])} to {number(relative.interval[1])} px with a "
        f"confidence of 95 %)."
    )


def _keys(found: Evaluation) -> tuple[KeyFigure, ...]:
    def remark(name: str) -> str:
        low, high = found.estimates[name].interval
        return f"95 %: {number(low)} … {number(high)}"

    labels = {
        "bias_e_m": ("m", "shift to the reference, east"),
        "bias_n_m": ("m", "shift to the reference, north"),
        "ce90_m": ("m", "CE90"),
        "relative_px": ("px", "relative accuracy"),
    }
    return tuple(
        KeyFigure(number(found.estimates[name].value), unit, label, remark(name))
        for name, (unit, label) in labels.items()
    )


def _interval(estimate: Estimate, digits: int) -> str:
    low, high = (number(value, digits) for value in estimate.interval)
    return f"{number(estimate.value, digits)} ({low} … {high})"


def _tables(results: Sequence[SceneResult], names: Sequence[str]) -> list[Block]:
    relative, absolute, lost = [], [], []
    for name, result in zip(names, results, strict=True):
        found, facts = result.evaluation, result.facts
        side = facts.get("side_swing_deg")
        heads = (
            str(facts.get("date", result.product.details.get("time", name))),
            number(float(side), 3) if isinstance(side, int | float) else "–",
            str(facts.get("region", "–")),
        )
        relative += _rows(found, heads, ("relative_px", "v_x", "v_y", "m_x", "m_y"), 3)
        metres = ("bias_e_m", "bias_n_m", "rmse_e_m", "rmse_n_m", "ce90_m")
        absolute += _rows(found, (name, str(found.points)), metres, 2)
        share = f"{number(100.0 * coverage(found.matches), 0)} %"
        lost.append((name, *(str(count) for count in found.matches.counts.values()), share))
    kinds = {result.evaluation.options.relative for result in results}
    removed = REMOVED[kinds.pop()] if len(kinds) == 1 else "what each scene's options name"
    causes = [cause.replace("_", " ") for cause in results[0].evaluation.matches.counts]
    return [
        Table(
            f"Relative geometric accuracy, pixels, after removing {removed}; below each number its "
            "interval of 95 %. Average of the errors over points held out of the fit (V), root "
            "mean square (M), along the track (x) and across it (y); the relative accuracy is "
            "hypot(Mx, My).",
            ("time", "swing, °", "region", "relative", "V x", "V y", "M x", "M y"),
            relative,
            strong=tuple(range(0, len(relative), 2)),
        ),
        Table(
            "Absolute accuracy, metres; below each number its interval of 95 %. The bias is what "
            "brings the image onto the reference.",
            ("scene", "points", "bias E", "bias N", "RMSE E", "RMSE N", "CE90"),
            absolute,
            strong=tuple(range(0, len(absolute), 2)),
        ),
        Table(
            "What became of the patches; the coverage is the share of the overlap, in an 8 × 8 "
            "division, that holds a match.",
            ("scene", *causes, "coverage"),
            lost,
        ),
        *_heights(results, names),
    ]


def _rows(
    found: Evaluation, heads: tuple[str, ...], keys: Sequence[str], digits: int
) -> list[tuple[str, ...]]:
    """Two rows of a table: numbers, and below them their intervals."""
    estimates = [found.estimates[key] for key in keys]
    values = (number(estimate.value, digits) for estimate in estimates)
    # an interval tells its third decimal only where there is nothing before it
    narrow = max(high - low for low, high in (e.interval for e in estimates)) < 0.1
    fewer = digits if narrow else min(digits, 2)
    low_high = (
        " … ".join(number(value, fewer) for value in estimate.interval) for estimate in estimates
    )
    blank = ("",) * (len(heads) - 1)
    return [(*heads, *values), (*blank, "95 %", *low_high)]


def _heights(results: Sequence[SceneResult], names: Sequence[str]) -> list[Block]:
    rows = []
    for name, result in zip(names, results, strict=True):
        if result.heights is not None:
            e = result.heights.estimates
            cells = (_interval(e[key], 2) for key in ("bias_u_m", "rmse_u_m", "le90_m"))
            rows.append((name, str(result.heights.points), *cells))
    if not rows:
        return []
    caption = (
        "Heights of intersected points against the DEM, metres, with intervals of 95 %. The bias "
        "is what brings them onto it."
    )
    return [Table(caption, ("scene", "points", "bias U", "RMSE U", "LE90"), rows)]


def _method(found: Evaluation) -> list[Block]:
    reference = found.options.reference_sigma_m
    known = (
        f"The reference's own place is known to {reference:g} m per axis, which widens the "
        "intervals of the absolute numbers."
        if reference
        else "No accuracy is stated for the reference: the absolute numbers are against it, and "
        "their intervals do not hold its own error."
    )
    raw = found.raw
    return [
        Text(
            "Patches of the image are brought to the orthophoto's lattice through the model and "
            "the DEM, found by normalised correlation from coarse to fine and refined by least "
            "squares with gain and offset. Outliers leave by a cubic polynomial of the residuals."
        ),
        Text(
            "The matching's own variance, "
            f"{number(found.noise_px[0], 3)} px along and {number(found.noise_px[1], 3)} px "
            "across, is taken out of mean squares. As measured, with it: Mx "
            f"{number(raw['m_x'], 3)} px, My {number(raw['m_y'], 3)} px, CE90 "
            f"{number(raw['ce90_m'])} m."
        ),
        Note(known),
    ]


def _options(result: SceneResult) -> str:
    s = result.settings
    return (
        f"relative {s.relative}, window {s.window_px} px, spacing "
        f"{result.evaluation.matches.spacing_px} px, search {s.search_m:g} m, least correlation "
        f"{s.least_correlation:g}, {'; '.join(result.terrain_facts)}"
    )
