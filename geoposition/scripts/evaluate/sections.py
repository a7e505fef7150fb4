"""One scene's part of an accuracy report: pictures, vectors, profiles, vibrations, CCDs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.calib_fields.evaluate import Evaluation
from geoposition.calib_fields.geometry import OrthoImage
from geoposition.calib_fields.smooth import ImageCorrection
from geoposition.scripts import figures
from geoposition.scripts.evaluate import figures as evaluate_figures
from geoposition.scripts.report import Block, Image, Table, Text, number

if TYPE_CHECKING:
    from geoposition.scripts.evaluate.run import SceneResult

REMOVED: Final = {
    "shift": "a constant shift",
    "affine": "an affine map",
    "attitude": "a constant attitude error",
}
"""What was taken out before the relative numbers, in words."""
_THUMBNAIL_PX: Final = 320
_MOST_ARROWS: Final = 400


def scene_blocks(result: SceneResult) -> list[Block]:
    """Figures and tables of one scene."""
    found, matches = result.evaluation, result.evaluation.matches
    used = matches.used & np.isfinite(matches.error_px).all(axis=1)
    place, residual = matches.model_px[used], found.residual_px
    few = np.linspace(0, len(place) - 1, min(len(place), _MOST_ARROWS)).astype(np.int64)
    shift = matches.shift_en_m[used]
    lines, samples = result.product.model.shape
    lying = lines > evaluate_figures.LYING * samples
    order = slice(None) if lying else slice(None, None, -1)
    panels = [
        figures.VectorPanel(title, place[few][:, order], error[few][:, order])
        for title, error in (
            ("Error in the image", matches.error_px[used]),
            (f"After removing {REMOVED[found.options.relative]}", residual),
        )
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
            evaluate_figures.lying_vectors(panels, unit="px")
            if lying
            else figures.vectors(panels, unit="px", place_labels=("sample", "line"), down=True),
            "Observed less modelled place in the image, as vectors"
            + ("; the lines run to the right." if lying else "."),
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
    image = OrthoImage(result.source, model, terrain, ImageCorrection.none(), node_px=4)
    ortho = image.on(grid, overlap.mean_sample_m, overlap.pixel_m * times)
    return {"Reference orthophoto": dom.read(grid), "Image, brought to it": ortho.grey}
