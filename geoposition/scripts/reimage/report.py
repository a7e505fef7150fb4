"""The HTML page about one re-imaging: pictures, displacements, spectra, RPC before and after."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import rasterio
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rasterio.windows import Window

from geoposition.arrays import FloatArray
from geoposition.reimage.raster_files import opened_image
from geoposition.reimage.sinusoids import amplitude_spectrum
from geoposition.rpc.fit_build import RpcFit
from geoposition.scripts.figures import COLOURS, STYLE, png
from geoposition.scripts.reimage.run import Run
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
    render,
)
from geoposition.scripts.tables import whole_file

_WINDOW: Final = 320
_MOST_POINTS: Final = 4000
_DOUBTFUL_PX: Final = 0.05
_ARCSEC_RAD: Final = float(np.pi / 648000.0)
_AXES: Final = ("roll", "pitch", "yaw")
_IMAGE_AXES: Final = ("rows", "columns")


def write(path: Path, run: Run) -> None:
    """Write the page about `run`, whole or not at all."""
    page = render(build(run))
    with whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def build(run: Run) -> Report:
    """Put the page's pieces together."""
    facts: Any = run.summary
    moved, gone = facts["displacement_px"], facts["removed_px"]
    keys = [
        KeyFigure(number(gone["row"]["rms"], 3), "px", "taken out, rows", "rms about the mean"),
        KeyFigure(number(gone["col"]["rms"], 3), "px", "taken out, columns", "rms"),
        KeyFigure(_small(_largest(run.after)), "px", "RPC misfit", "steady, largest"),
        KeyFigure(_small(facts["mapping"]["error_px"]), "px", "interpolation", "largest, measured"),
    ]
    if run.before is not None:
        keys.insert(2, KeyFigure(_small(_largest(run.before)), "px", "RPC misfit", "as taken"))
    return Report(
        title=f"Steady image of {run.request.image.name}",
        summary=(
            f"The attitude was smoothed by a {facts['steady']}; the image was brought to what a "
            f"steady camera with {facts['camera']} would have taken, through "
            f"{facts['mapping']['terrain']}."
        ),
        key_figures=keys,
        sections=[
            Section("Before and after", _pictures(run)),
            Section("Displacement along the image", _displacement(run, moved)),
            Section("Jitter", _jitter(run)),
            Section("Attitude taken out", _removed(run)),
            Section("RPC", _rpc(run)),
            Section("How exact", _exactness(facts)),
        ],
        provenance=provenance(
            {"product": facts["product"], "image": facts["image"], "attitude": facts["attitude"]}
        ),
    )


def _pictures(run: Run) -> list[Block]:
    row, col = _liveliest(run)
    lines, samples = min(_WINDOW, run.steady.shape[0]), min(_WINDOW, run.steady.shape[1])
    with opened_image(run.request.image) as image:
        shape = image.shape
        row0, col0 = min(row, shape[0] - lines), min(col, shape[1] - samples)
        before = image.window(max(row0, 0), max(col0, 0), lines, samples)[0]
    with rasterio.open(run.files["steady"]) as steady:
        after = steady.read(1, window=Window(max(col0, 0), max(row0, 0), samples, lines))
    caption = (
        f"{before.shape[1]} columns and {before.shape[0]} rows from ({row0}, {col0}) on, where "
        "the displacement changes most. Left as taken, middle steady, right their difference."
    )
    return [Image(_side_by_side(before, after), caption, "The same place before and after")]


def _liveliest(run: Run) -> tuple[int, int]:
    """First row and column of the window in which displacement varies most."""
    mean = np.nan_to_num(run.moved_px)
    lines, samples = run.steady.shape
    size = min(_WINDOW, lines)
    starts = np.arange(0, lines - size + 1, max(size // 2, 1))
    spread = [float(mean[start : start + size].std(axis=0).sum()) for start in starts]
    return int(starts[int(np.argmax(spread))]), max((samples - _WINDOW) // 2, 0)


def _displacement(run: Run, facts: Any) -> list[Block]:
    mean, times = run.moved_px, run.times_s
    rows = [
        [name, number(part["mean"], 4, sign=True), number(part["rms"], 4), number(part["max"], 4)]
        for name, part in zip(_IMAGE_AXES, (facts["row"], facts["col"]), strict=True)
    ]
    blocks: list[Block] = [
        Table("Place in the image as taken less place in the steady one, pixels",
              ["", "mean", "rms about it", "largest"], rows),
        Image(_profiles(np.arange(len(mean)), mean),
              "What the attitude taken out moves each row, pixels.",
              "Displacement of rows and columns along the image"),
    ]  # fmt: skip
    if len(mean) >= 64 and np.isfinite(mean).all():
        order = np.argsort(times)
        frequency, amplitude = amplitude_spectrum(times[order], mean[order])
        caption = "Amplitude of the displacement by frequency, pixels; Hann window."
        blocks.append(
            Image(_spectrum(frequency, amplitude, _IMAGE_AXES, "px"), caption, "Spectrum, pixels")
        )
    return blocks


def _jitter(run: Run) -> list[Block]:
    """Lines as the attitude, the images and a match have them, in one table."""
    rows, groups = [], 0
    for axis, lines in zip(_IMAGE_AXES, run.jitter.by_axis, strict=True):
        for line in lines:
            groups += 1
            for name, seen in line.by_source.items():
                if seen is None:
                    continue
                arcsec = seen.amplitude * run.jitter.pixel_rad / _ARCSEC_RAD
                rows.append([
                    f"{groups}, {axis}", name,
                    number(seen.frequency_hz, 3), number(seen.sigma_frequency_hz, 3),
                    number(seen.amplitude, 4), number(seen.sigma_amplitude, 4),
                    number(arcsec, 4),
                    number(seen.phase_rad, 3, sign=True), number(seen.sigma_phase_rad, 3),
                ])  # fmt: skip
    if not rows:
        return [Text("No line stands out of the displacement.")]
    header = ["line", "seen by", "Hz", "±", "amplitude, px", "±", "″", "phase, rad", "±"]
    return [
        Text(
            "Displacement of the image as taken, a cos(2π f t + phase), t = 0 of the camera's "
            "timing; ± is one standard deviation. Lines of one number are one line: their "
            "frequencies lie within one and a half periods of the image."
        ),
        Table("Jitter as each source has it", header, rows),
    ]


def _removed(run: Run) -> list[Block]:
    arcsec = run.removed.removed_rad / _ARCSEC_RAD
    rows = [
        [axis, number(float(np.sqrt(np.mean(arcsec[:, k] ** 2))), 4),
         number(float(np.abs(arcsec[:, k]).max()), 4)]
        for k, axis in enumerate(_AXES)
    ]  # fmt: skip
    frequency, amplitude = amplitude_spectrum(run.removed.times_s, arcsec)
    return [
        Table("Rotation taken out, arcseconds about the body's axes", ["", "rms", "largest"], rows),
        Image(_spectrum(frequency, amplitude, _AXES, "″"),
              "Amplitude of the removed rotation by frequency, arcseconds; Hann window.",
              "Spectrum of the removed attitude"),
    ]  # fmt: skip


def _rpc(run: Run) -> list[Block]:
    fits = {"as taken": run.before, "steady": run.after}
    rows = []
    for name, fit in fits.items():
        if fit is not None and fit.check is not None:
            row, col = fit.check.row, fit.check.col
            rows.append([name, *(_small(v) for v in (row.rms, row.max, col.rms, col.max))])
    header = ["model", "rows, rms", "rows, max", "columns, rms", "columns, max"]
    blocks: list[Block] = [
        Text("What the best RPC misses of the rigorous model between the nodes of its fit."),
        Table("Misfit, pixels", header, rows, strong=(len(rows) - 1,)),
        Image(_misfits(run), "RPC − model along the image, pixels, at the middle height.",
              "Misfit along the image"),
    ]  # fmt: skip
    if _largest(run.after) > _DOUBTFUL_PX:
        blocks.append(
            Note(
                "The RPC does not follow the steady model: a lower cut-off, or a polynomial, does."
            )
        )
    return blocks


def _exactness(facts: Any) -> list[Block]:
    mapping = facts["mapping"]
    height = mapping["height_error_px"]
    blocks: list[Block] = [
        Text(
            f"Every row was mapped exactly; between nodes {mapping['node_step_px']} columns apart "
            f"the largest error found is {_small(mapping['error_px'])} px, the bound "
            f"{mapping['bound_px']:g} px. {facts['valid_share']:.2%} of the pixels are seen."
        )
    ]
    if max(height) > 0.0:
        blocks.append(
            Note(
                f"One height stands for the ground: at the ends of the height range this costs "
                f"{_small(height[0])} px in rows and {_small(height[1])} px in columns."
            )
        )
    return blocks


def _largest(fit: RpcFit) -> float:
    return float("nan") if fit.check is None else fit.check.largest_px


def _small(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.2g}"


def _side_by_side(before: NDArray[Any], after: NDArray[Any]) -> bytes:
    a, b = before.astype(np.float64), after.astype(np.float64)
    low, high = np.nanpercentile(b, [1.0, 99.0])
    difference = a - b
    limit = max(float(np.nanpercentile(np.abs(difference), 99.0)), 1e-6)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.4), layout="constrained")
        row = figure.subplots(1, 3)
        for axes, title, values in zip(row[:2], ("As taken", "Steady"), (a, b), strict=True):
            axes.imshow(values, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
            axes.set_title(title)
        row[2].imshow(difference, cmap="PuOr_r", vmin=-limit, vmax=limit, interpolation="nearest")
        row[2].set_title("Difference")
        for axes in row:
            axes.set_xticks([])
            axes.set_yticks([])
        return png(figure)


def _profiles(line: NDArray[Any], moved: FloatArray) -> bytes:
    pick = slice(None, None, max(len(line) // _MOST_POINTS, 1))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 3.0), layout="constrained")
        column = figure.subplots(2, 1, sharex=True)
        for k, (axes, name) in enumerate(zip(column, _IMAGE_AXES, strict=True)):
            axes.axhline(0.0, color="#999999", lw=0.6)
            axes.plot(line[pick], moved[pick, k], color=COLOURS[k], lw=0.7)
            axes.set_ylabel(f"{name}, px")
            axes.margins(x=0.0)
        column[-1].set_xlabel("row")
        return png(figure)


def _spectrum(
    frequency: FloatArray, amplitude: FloatArray, labels: tuple[str, ...], unit: str
) -> bytes:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 2.8), layout="constrained")
        axes = figure.add_subplot()
        for k, label in enumerate(labels):
            axes.loglog(frequency[1:], np.maximum(amplitude[1:, k], 1e-12), lw=0.8,
                        color=COLOURS[k], label=label)  # fmt: skip
        top = float(amplitude[1:].max(initial=1e-12))
        axes.set_ylim(1e-5 * top, 2.0 * top)
        axes.set_xlabel("frequency, Hz")
        axes.set_ylabel(f"amplitude, {unit}")
        axes.legend()
        return png(figure)


def _misfits(run: Run) -> bytes:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 3.0), layout="constrained")
        column = figure.subplots(2, 1, sharex=True)
        for k, (name, fit) in enumerate({"as taken": run.before, "steady": run.after}.items()):
            if fit is None or fit.check is None:
                continue
            for axis, axes in enumerate(column):
                axes.plot(fit.check.profile_line_px, fit.check.profile_px[:, axis],
                          color=COLOURS[k], lw=0.8, label=name)  # fmt: skip
        for axes, label in zip(column, _IMAGE_AXES, strict=True):
            axes.axhline(0.0, color="#999999", lw=0.6)
            axes.set_ylabel(f"{label}, px")
            axes.margins(x=0.0)
        column[0].legend()
        column[-1].set_xlabel("row")
        return png(figure)
