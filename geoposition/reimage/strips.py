"""A whole image, strip by strip: only the lines that a strip looks at are held."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from geoposition.arrays import FlagArray, FloatArray
from geoposition.errors import ArgumentError
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.mapping import DEFAULT_BOUND_PX, RowMap, SourceMapping, map_models
from geoposition.reimage.resample import Resampler
from geoposition.reimage.virtual import Segment, single_ccd
from geoposition.sensor_model import SensorModel
from geoposition.terrain import Terrain

STRIP_ROWS: Final = 512

_MAP_ROWS: Final = 2048

ReadLines = Callable[[int, int], NDArray[Any]]
"""Lines first ... end − 1 of the source, as (bands, lines, samples)."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Columns `first_col` ... `end_col` − 1 of the target, from a span of the source's samples.

    `mapping` leads to a source that begins at `first_sample` and has `samples` of them.
    """

    mapping: SourceMapping
    first_col: int
    end_col: int
    first_sample: int
    samples: int


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """Rows of the new image from `first_row` on.

    `pixels` (bands, rows, cols), `valid` (rows, cols), and the map of each part.
    """

    first_row: int
    pixels: NDArray[Any]
    valid: FlagArray
    maps: tuple[RowMap, ...]

    @property
    def error_px(self) -> float:
        """Largest interpolation error found."""
        return max(places.error_px for places in self.maps)


def parts_of(
    target: SensorModel,
    source: PushbroomModel,
    terrain: Terrain | float,
    segments: Sequence[Segment] = (),
    bound_px: float = DEFAULT_BOUND_PX,
) -> tuple[Part, ...]:
    """Map `target` to `source`: as a whole, or each of the `segments` to its own CCD."""
    samples = source.shape[1]
    if not segments:
        mapping = map_models(target, source, terrain, bound_px)
        return (Part(mapping, 0, target.shape[1], 0, samples),)
    known: dict[int, SourceMapping] = {}
    parts = []
    for segment in segments:
        number = segment.number
        if number not in known:
            known[number] = map_models(target, single_ccd(source, number), terrain, bound_px)
        first = round(source.camera.detectors[number].first_sample)
        own = known[number].source.shape[1]
        parts.append(Part(known[number], segment.first_col, segment.end_col, first, own))
    return tuple(parts)


def strips(
    parts: Sequence[Part],
    read_lines: ReadLines,
    resampler: Resampler,
    rows: int = STRIP_ROWS,
    span: tuple[int, int] | None = None,
) -> Iterator[Strip]:
    """Make the target's image in strips of `rows` rows; the next lines are read meanwhile.

    Of the image, the rows of `span`, first and end, are made: all if left out. A strip is the
    same whatever the span that it is in, if that begins at a multiple of `block_rows(rows)`.
    """
    if rows < 1 or not parts:
        raise ArgumentError("re-imaging: at least one part and one row a strip expected")
    source_lines = parts[0].mapping.source.shape[0]
    with ThreadPoolExecutor(max_workers=1) as reader:
        waiting: tuple[tuple[RowMap, ...], int, Future[NDArray[Any]]] | None = None
        whole = 0, parts[0].mapping.target.shape[0]
        for maps in _row_maps(parts, rows, whole if span is None else span):
            first, end = _lines_of(maps, resampler.reach, source_lines)
            ahead = maps, first, reader.submit(read_lines, first, end)
            if waiting is not None:
                yield _strip(parts, *waiting, resampler)
            waiting = ahead
        if waiting is not None:
            yield _strip(parts, *waiting, resampler)


def block_rows(rows: int) -> int:
    """Rows that are mapped at once: whole strips of `rows` rows."""
    return rows * max(_MAP_ROWS // rows, 1)


def _row_maps(
    parts: Sequence[Part], rows: int, span: tuple[int, int]
) -> Iterator[tuple[RowMap, ...]]:
    """Give the maps of each part, strip by strip; they are made for many rows at a time."""
    block = block_rows(rows)
    different = {id(part.mapping): part.mapping for part in parts}
    for start in range(*span, block):
        end = min(start + block, span[1])
        made = {key: mapping.rows(start, end) for key, mapping in different.items()}
        for first in range(start, end, rows):
            last = min(first + rows, end)
            yield tuple(made[id(part.mapping)].part(first, last) for part in parts)


def _lines_of(maps: Sequence[RowMap], reach: int, source_lines: int) -> tuple[int, int]:
    """First line of the source that `maps` need, and the one after the last."""
    spans = [span for span in (places.source_lines() for places in maps) if span is not None]
    if not spans:
        return 0, 1
    low, high = min(a for a, _ in spans), max(b for _, b in spans)
    first = int(np.clip(np.floor(low) - reach, 0, source_lines - 1))
    return first, int(np.clip(np.ceil(high) + reach, first, source_lines - 1)) + 1


def _strip(
    parts: Sequence[Part],
    maps: tuple[RowMap, ...],
    first_line: int,
    reading: Future[NDArray[Any]],
    resampler: Resampler,
) -> Strip:
    image, start = reading.result(), maps[0].first_row
    if len(parts) == 1:
        only = parts[0]
        pixels, valid = resampler.rows(image, maps[0], only.end_col, (first_line, 0))
        return Strip(start, pixels, valid, maps)
    made = []
    for part, places in zip(parts, maps, strict=True):
        own = image[:, :, part.first_sample : part.first_sample + part.samples]
        cols = part.end_col - part.first_col
        own = np.ascontiguousarray(own)
        made.append(resampler.rows(own, places, cols, (first_line, 0), part.first_col))
    pixels = np.concatenate([values for values, _ in made], axis=2)
    return Strip(start, pixels, np.concatenate([seen for _, seen in made], axis=1), maps)


def displacement_px(parts: Sequence[Part], strip: Strip, cols: FloatArray) -> FloatArray:
    """Where each row's pixels come from, less their own place: (rows, k, 2) at `cols` (k,)."""
    out = np.empty((strip.valid.shape[0], len(cols), 2))
    for part, places in zip(parts, strip.maps, strict=True):
        here = (cols >= part.first_col) & (cols < part.end_col)
        out[:, here] = places.displacement_px(cols[here])
        out[:, here, 1] += part.first_sample
    return out
