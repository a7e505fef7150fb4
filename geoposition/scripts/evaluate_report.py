"""The accuracy report of one scene or of several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.calib_fields.evaluate import Evaluation
from geoposition.calib_fields.geometry import OrthoImage
from geoposition.calib_fields.smooth import ImageCorrection
from geoposition.scripts import evaluate_figures, figures
from geoposition.scripts.report import (
    Block,
    Image,
    KeyFigure,
    Note,
    Report,
    Section,
    Table,
    Text,
    number,
    provenance,
)

if TYPE_CHECKING:
    from geoposition.scripts.evaluate_run import SceneResult

_REMOVED: Final = {
    "shift": "a constant shift",
    "affine": "an affine map",
    "attitude": "a constant attitude error",
}
_THUMBNAIL_PX: Final = 320
_MOST_ARROWS: Final = 400


def build_report(results: Sequence[SceneResult], inputs: Mapping[str, str]) -> Report:
    """Report of `results`; `inputs` are the files and their checksums."""
    first = results[0].evaluation
    several = len(results) > 1
    names = [str(result.facts.get("name", k + 1)) for k, result in enumerate(results)]
    sections = [Section("Accuracy", _tables(results, names))]
    for name, result in zip(names, results, strict=True):
        sections.append(Section(name if several else "The scene", _scene(result)))
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
            f"removing {_REMOVED[first.options.relative]}: {number(min(sizes))} to "
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
        f"{found.points} of {len(found.matches.cause)} patches match the reference orthophoto. "
        f"The image comes onto it by a shift of {number(e.value, 2, sign=True)} m east and "
        f"{number(n.value, 2, sign=True)} m north. Within itself, after removing "
        f"{_REMOVED[found.options.relative]}, it is right to {number(relative.value)} px "
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


def _cell(found: Evaluation, name: str, digits: int = 3) -> str:
    estimate = found.estimates[name]
    low, high = (number(value, digits) for value in estimate.interval)
    return f"{number(estimate.value, digits)} ({low} … {high})"


def _tables(results: Sequence[SceneResult], names: Sequence[str]) -> list[Block]:
    relative, absolute, lost = [], [], []
    for name, result in zip(names, results, strict=True):
        found = result.evaluation
        facts = result.facts
        side = facts.get("side_swing_deg")
        relative.append(
            (
                str(facts.get("date", result.product.details.get("time", name))),
                number(float(side), 3) if isinstance(side, int | float) else "–",
                str(facts.get("region", "–")),
                *(_cell(found, key) for key in ("relative_px", "v_x", "v_y", "m_x", "m_y")),
            )
        )
        absolute.append(
            (
                name,
                str(found.points),
                *(
                    _cell(found, key, 2)
                    for key in ("bias_e_m", "bias_n_m", "rmse_e_m", "rmse_n_m", "ce90_m")
                ),
            )
        )
        lost.append((name, *(str(count) for count in found.matches.counts.values())))
    removed = _REMOVED[results[0].evaluation.options.relative]
    causes = [cause.replace("_", " ") for cause in results[0].evaluation.matches.counts]
    return [
        Table(
            f"Relative geometric accuracy, pixels, after removing {removed}, with intervals of "
            "95 %. Average of the errors over points held out of the fit (V), root mean square "
            "(M), along the track (x) and across it (y); the relative accuracy is hypot(Mx, My).",
            ("time", "side swing, °", "region", "relative", "V x", "V y", "M x", "M y"),
            relative,
        ),
        Table(
            "Absolute accuracy, metres, with intervals of 95 %. The bias is what brings the image "
            "onto the reference.",
            ("scene", "points", "bias E", "bias N", "RMSE E", "RMSE N", "CE90"),
            absolute,
        ),
        Table("What became of the patches.", ("scene", *causes), lost),
    ]


def _scene(result: SceneResult) -> list[Block]:
    found, matches = result.evaluation, result.evaluation.matches
    used = matches.used & np.isfinite(matches.error_px).all(axis=1)
    place, residual = matches.model_px[used], found.residual_px
    few = np.linspace(0, len(place) - 1, min(len(place), _MOST_ARROWS)).astype(np.int64)
    shift = matches.shift_en_m[used]
    panels = [
        figures.VectorPanel(
            "Error in the image", place[few][:, ::-1], matches.error_px[used][few][:, ::-1]
        ),
        figures.VectorPanel(
            f"After removing {_REMOVED[found.options.relative]}",
            place[few][:, ::-1],
            residual[few][:, ::-1],
        ),
    ]
    blocks: list[Block] = [
        Image(
            evaluate_figures.beside(thumbnails(result)),
            "The reference orthophoto and the image brought to it through its model and the DEM.",
            "Two grey images of the same ground.",
        ),
        Image(
            evaluate_figures.distribution(matches, result.product.model.shape),
            "Where the patches lie in the image, and what became of them.",
            "Map of points over the image, marked by cause.",
        ),
        Image(
            figures.vectors(panels, unit="px", place_labels=("sample", "line"), down=True),
            "Observed less modelled place in the image, as vectors.",
            "Two vector fields over the image.",
        ),
        Image(
            figures.histograms(
                {"x, along track": residual[:, 0], "y, across track": residual[:, 1]},
                unit="residual, px",
            ),
            "Distribution of the residuals.",
            "Two histograms.",
        ),
        Image(
            figures.histograms(
                {"east": shift[:, 0], "north": shift[:, 1]}, unit="reference less located, m"
            ),
            "Distribution of the shifts on the ground.",
            "Two histograms.",
        ),
        Image(
            evaluate_figures.profiles(found.along, found.across),
            "Residuals averaged by line (above) and by sample (below); shaded: two standard "
            "deviations of the mean.",
            "Two line plots, each of two series with bands.",
        ),
    ]
    if len(found.spectrum.frequency):
        blocks.append(
            Image(
                evaluate_figures.spectrum(found.spectrum),
                "Amplitude of vibrations left in the residuals, corrected for what the patches "
                "average away.",
                "Line plot of two spectra.",
            )
        )
    blocks += _vibrations(found) + _ccds(found)
    return blocks


def _vibrations(found: Evaluation) -> list[Block]:
    if not found.spectrum.lines:
        return [Text("No vibration stands out of the residuals.")]
    rows = [
        (
            f"{line.frequency:.4g} ± {2.0 * line.sigma_frequency:.2g}",
            *(number(amplitude, 3) for amplitude in line.amplitude_px),
            number(2.0 * line.sigma_amplitude_px, 3),
        )
        for line in found.spectrum.lines
    ]
    header = (f"frequency, {found.spectrum.unit}", "along, px", "across, px", "±, px")
    return [Table("Vibrations left in the residuals, with two standard deviations.", header, rows)]


def _ccds(found: Evaluation) -> list[Block]:
    if len(found.ccds) < 2:
        return []
    rows = [
        (
            str(ccd.number),
            str(ccd.points),
            *(
                f"{number(mean, 3)} ± {number(2.0 * sigma, 3)}"
                for mean, sigma in zip(ccd.mean_px, ccd.sigma_px, strict=True)
            ),
        )
        for ccd in found.ccds
    ]
    return [Table("Mean residuals by CCD, pixels.", ("CCD", "points", "along", "across"), rows)]


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


def thumbnails(result: SceneResult) -> dict[str, FloatArray]:
    """Read the orthophoto, and the image brought to it, coarsely."""
    from geoposition.calib_fields.overlap import find_overlap
    from geoposition.terrain import RasterTerrain

    model, dom = result.product.model, result.dom
    terrain = RasterTerrain(result.settings.dem, result.settings.geoid)
    overlap = find_overlap(model, terrain, dom, result.settings.search_m)
    times = max(1, -(-max(overlap.shape) // _THUMBNAIL_PX))
    lattice = dom.coarser(overlap.factor * times)
    top, left, bottom, right = (n // times for n in overlap.bounds)
    grid = lattice.window(top, left, max(bottom - top, 2), max(right - left, 2))
    image = OrthoImage(result.source, model, terrain, ImageCorrection.none())
    ortho = image.on(grid, overlap.mean_sample_m, overlap.pixel_m * times)
    return {"Reference orthophoto": dom.read(grid), "Image, brought to it": ortho.grey}
