"""The jitter as three see it: the attitude, overlapping CCDs, and a match with a reference.

All are lines a cos(2 pi f t + phase) of the displacement in the image as it was taken, t = 0 of
the camera's timing, in pixels; so they stand beside each other.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import GeopositionError, MissingFileError, ProductError
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.jitter_parallax import ComparedLine, compared, jitter_of
from geoposition.reimage.mapping import map_models
from geoposition.reimage.parallax import measure_parallax
from geoposition.reimage.raster_files import ImageFile
from geoposition.reimage.sinusoids import Sinusoid, strongest
from geoposition.reimage.virtual import cropped_model, single_ccd
from geoposition.terrain import Terrain

AXES: Final = ("row", "col")
ATTITUDE: Final = "attitude"
MATCH: Final = "match"

_MOST_PIXELS: Final = 2_000_000
_LEAST_COLS: Final = 24
_MOST_COLS: Final = 256
_MARGIN: Final = 12
_MOST_PAIRS: Final = 3
_LEAST_MATCHES: Final = 12
_LEAST_ROWS: Final = 64
_MOST_LINES: Final = 6
_LEAST_PX: Final = 1e-3
_PLACES: Final = 3

Lines = Mapping[str, Sequence[Sinusoid]]
"""Lines of the jitter by who saw them."""


@dataclass(frozen=True, slots=True, eq=False)
class JitterTable:
    """Lines beside each other, for rows and columns of the image; a pixel's width as an angle."""

    by_axis: tuple[tuple[ComparedLine, ...], tuple[ComparedLine, ...]]
    pixel_rad: float

    def facts(self) -> list[dict[str, object]]:
        """Each line as plain numbers, with those who saw it."""
        return [
            {
                "axis": axis,
                "frequency_hz": line.frequency_hz,
                "sources": {
                    name: line_facts(seen) for name, seen in line.by_source.items() if seen
                },
            }
            for axis, lines in zip(AXES, self.by_axis, strict=True)
            for line in lines
        ]


def line_facts(line: Sinusoid) -> dict[str, float]:
    """Say what a line of a displacement is."""
    return {
        "frequency_hz": line.frequency_hz,
        "amplitude_px": line.amplitude,
        "phase_rad": line.phase_rad,
        "sigma_frequency_hz": line.sigma_frequency_hz,
        "sigma_amplitude_px": line.sigma_amplitude,
        "sigma_phase_rad": line.sigma_phase_rad,
    }


def jitter_table(model: PushbroomModel, sources: Sequence[tuple[Lines, Lines]]) -> JitterTable:
    """Lay the lines of `sources`, each for rows and columns, beside each other."""
    camera = model.camera
    times = camera.timing.time_s(np.array([0.0, model.shape[0] - 1.0]))
    within_hz = 1.5 / max(float(np.ptp(times)), 1e-6)
    both: list[tuple[ComparedLine, ...]] = []
    for k in range(2):
        merged: dict[str, Sequence[Sinusoid]] = {}
        for source in sources:
            merged |= source[k]
        both.append(compared(merged, within_hz) if merged else ())
    ccd = camera.detectors[0]
    ends = camera.tangents(0, np.array([ccd.first_sample, ccd.last_sample]))
    width = float(np.linalg.norm(ends[1] - ends[0])) / max(ccd.last_sample - ccd.first_sample, 1.0)
    return JitterTable((both[0], both[1]), width)


def attitude_displacement(
    jittered: PushbroomModel, steady: PushbroomModel, terrain: Terrain | float
) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) of rows, and how far (n, 2) px the attitude taken out moves them.

    In the first CCD, since another sees the same ground at another time; both models have the
    camera that took the image.
    """
    a, b = single_ccd(steady, 0), single_ccd(jittered, 0)
    rows = np.arange(a.shape[0], dtype=np.float64)
    cols = np.unique(np.linspace(0.0, a.shape[1] - 1.0, _PLACES).round())
    places = map_models(a, b, terrain).places(rows, cols)
    moved = row_means(places - np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1))
    return a.camera.timing.time_s(rows), moved


def displacement_lines(
    times: FloatArray, moved: FloatArray
) -> tuple[tuple[Sinusoid, ...], tuple[Sinusoid, ...]]:
    """Find the strongest lines of displacements (n, 2), for rows and columns."""
    return strongest_lines(times, moved[:, 0]), strongest_lines(times, moved[:, 1])


def row_means(moved_px: FloatArray) -> FloatArray:
    """Means (rows, 2) of displacements (rows, k, 2) over those k that are known; NaN if none."""
    known = np.isfinite(moved_px)
    total = np.where(known, moved_px, 0.0).sum(axis=1)
    count = known.sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def strongest_lines(times: FloatArray, values: FloatArray) -> tuple[Sinusoid, ...]:
    """Find lines of a displacement that matter; none where the image is too short."""
    if min(len(times), np.isfinite(values).sum()) < _LEAST_ROWS:
        return ()
    order = slice(None, None, 1 if times[-1] > times[0] else -1)
    found = strongest(times[order], values[order], _MOST_LINES)
    return tuple(line for line in found if line.amplitude >= _LEAST_PX)


def parallax_lines(
    image: ImageFile, steady: PushbroomModel, terrain: Terrain | float
) -> tuple[Lines, Lines]:
    """Lines that neighbouring CCDs tell by their overlap; none where there is no overlap.

    `steady` has the camera that took `image`, and the attitude without jitter.
    """
    rows: dict[str, Sequence[Sinusoid]] = {}
    cols: dict[str, Sequence[Sinusoid]] = {}
    for first, second in list(pairwise(range(len(steady.camera.detectors))))[:_MOST_PAIRS]:
        try:
            found = _pair(image, steady, terrain, first, second)
        except GeopositionError:
            continue  # no overlap, or nothing in it to compare
        name = f"CCDs {first} and {second}"
        rows[name] = [line for axis, line in found if axis == "line"]
        cols[name] = [line for axis, line in found if axis == "sample"]
    return rows, cols


def _pair(
    image: ImageFile, steady: PushbroomModel, terrain: Terrain | float, first: int, second: int
) -> list[tuple[str, Sinusoid]]:
    """Compare what two CCDs have in common, in columns so few that a whole pass fits in memory."""
    a, b = single_ccd(steady, first), single_ccd(steady, second)
    lines = a.shape[0]
    mapping = map_models(a, b, terrain)
    middle = mapping.places(np.array([0.5 * (lines - 1)]), np.arange(a.shape[1], dtype=np.float64))
    sample = middle[0, :, 1]
    inside = np.flatnonzero((sample >= 0.0) & (sample <= b.shape[1] - 1.0))
    if len(inside) < _LEAST_COLS:
        return []
    count = int(np.clip(_MOST_PIXELS // lines, _LEAST_COLS, min(_MOST_COLS, len(inside))))
    start = int(inside[0] + (len(inside) - count) // 2)
    there = sample[start : start + count]
    low = max(int(np.floor(there.min())) - _MARGIN, 0)
    high = min(int(np.ceil(there.max())) + _MARGIN + 1, b.shape[1])
    spans = (a, first, start, count), (b, second, low, high - low)
    models, pixels = [], []
    for model, number, column, width in spans:
        offset = round(steady.camera.detectors[number].first_sample)
        models.append(cropped_model(model, 0, column, (lines, width)))
        pixels.append(image.window(0, offset + column, lines, width)[0])
    parallax = measure_parallax(models[0], models[1], pixels[0], pixels[1], terrain)
    return [(line.axis, line.line) for line in jitter_of(parallax)]


def match_lines(path: Path, model: PushbroomModel) -> tuple[Lines, Lines]:
    """Lines of the residuals that `evaluate` found and wrote to `path`, evaluation.json.

    Phases are fitted to the residuals of its matches, and unknown where these are not there.
    """
    told = _evaluation(path)
    times, residual = _residuals(path, model)
    both: tuple[list[Sinusoid], list[Sinusoid]] = ([], [])
    for entry in told:
        for k, axis in enumerate("xy"):
            frequency = float(entry["frequency"])
            sigma_f, sigma = float(entry["frequency_sigma"]), float(entry["amplitude_sigma_px"])
            amplitude = float(entry[f"amplitude_{axis}_px"])
            phase, sigma_phase = _phase(times, residual[:, k], frequency, sigma_f)
            both[k].append(Sinusoid(frequency, amplitude, phase, sigma_f, sigma, sigma_phase))
    return {MATCH: both[0]}, {MATCH: both[1]}


def _evaluation(path: Path) -> list[dict[str, Any]]:
    if not path.is_file():
        raise MissingFileError(path, "", "an evaluation.json expected, there is no such file")
    try:
        told = json.loads(path.read_text(encoding="utf-8"))["jitter"]
        lines = [dict(entry) for entry in told if entry["unit"] == "Hz"]
        for entry in lines:
            for key in ("frequency", "frequency_sigma", "amplitude_sigma_px", "amplitude_x_px",
                        "amplitude_y_px"):  # fmt: skip
                entry[key] = float(entry[key])
    except (ValueError, KeyError, TypeError) as error:
        words = " ".join(str(error).split())
        raise ProductError(
            path, "jitter", f"the evaluation.json of one scene expected ({words})"
        ) from None
    return lines


def _residuals(path: Path, model: PushbroomModel) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) and residuals (n, 2), along and across, of the matches beside `path`."""
    matches = path.with_name("matches.gpkg")
    if not matches.is_file():
        return np.empty(0), np.empty((0, 2))
    import pyogrio.raw

    names = ["row", "residual_x_px", "residual_y_px"]
    meta, _, _, fields = pyogrio.raw.read(matches, columns=names, read_geometry=False)
    column = dict(zip(meta["fields"], fields, strict=True))
    if not set(names) <= set(column):
        raise ProductError(matches, "columns", f"{', '.join(names)} expected")
    values = np.stack([np.asarray(column[name], dtype=np.float64) for name in names], axis=-1)
    values = values[np.isfinite(values).all(axis=1)]
    return model.camera.timing.time_s(values[:, 0]), values[:, 1:]


def _phase(
    times: FloatArray, values: FloatArray, frequency_hz: float, sigma_hz: float
) -> tuple[float, float]:
    """Phase of a cosine at t = 0, by least squares at a known frequency, and its deviation."""
    if len(times) < _LEAST_MATCHES:
        return float("nan"), float("nan")
    turn = 2.0 * np.pi * frequency_hz * times
    design = np.stack([np.cos(turn), np.sin(turn), np.ones_like(turn)], axis=-1)
    solution, *_ = np.linalg.lstsq(design, values, rcond=None)
    rest = values - design @ solution
    variance = float(rest @ rest) / max(len(times) - 3, 1)
    covariance = np.linalg.pinv(design.T @ design)[:2, :2] * variance
    a, b = solution[:2]
    across = np.array([b, -a]) / max(a * a + b * b, 1e-30)
    about = 2.0 * np.pi * float(np.mean(times)) * sigma_hz
    return float(np.arctan2(-b, a)), float(np.hypot(np.sqrt(across @ covariance @ across), about))
