"""Pixel values at mapped places, for any common type of pixel, several bands, missing pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import DTypeLike, NDArray

from geoposition.arrays import FlagArray
from geoposition.errors import ArgumentError
from geoposition.reimage import resample_kernels as kernels
from geoposition.reimage import sample_kernels as samples
from geoposition.reimage.gather_kernels import bits_of, resample_gathered, words_of
from geoposition.reimage.mapping import RowMap
from geoposition.reimage.place_kernels import resample_places

Method: TypeAlias = Literal["nearest", "bilinear", "cubic", "lanczos"]

METHODS: Final[dict[str, int]] = {
    "nearest": samples.NEAREST,
    "bilinear": samples.BILINEAR,
    "cubic": samples.CUBIC,
    "lanczos": samples.LANCZOS,
}
PIXEL_TYPES: Final = ("uint8", "int16", "uint16", "float32")
"""What 32-bit floats hold without loss."""

Pixels: TypeAlias = NDArray[Any]

_SIGN: Final = np.uint16(1 << 15)


@dataclass(frozen=True, slots=True)
class Resampler:
    """How values are found between pixels, and which value stands for no pixel.

    Whole numbers are rounded and kept within their type: a kernel with negative weights can
    leave the range of what it looks at, not that of the type, and never becomes `nodata`.
    Without `nodata` what is not seen is 0, for floats NaN, and only `valid` tells.
    """

    method: Method = "cubic"
    nodata: float | None = None

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ArgumentError(
                f"resampling: one of {', '.join(METHODS)} expected, got {self.method!r}"
            )

    @property
    def reach(self) -> int:
        """Pixels on either side of a place that are looked at."""
        return samples.REACH[METHODS[self.method]]

    def rows(
        self,
        image: Pixels,
        places: RowMap,
        cols: int,
        origin: tuple[int, int] = (0, 0),
        first_col: int = 0,
    ) -> tuple[Pixels, FlagArray]:
        """Values (bands, rows, cols) at `places`, and where there are any (rows, cols).

        `image` (bands, lines, samples) is a window whose first pixel is at `origin` of the
        source; `cols` columns are made, from `first_col` on.
        """
        if image.dtype == np.int16:
            return self._signed(
                image, lambda sampler, raised: sampler.rows(raised, places, cols, origin, first_col)
            )
        shape = len(places.places), cols
        out, valid = _empty(image, shape)
        for number, (band, target) in enumerate(zip(image, out, strict=True)):
            limits = self._limits(band.dtype)
            seen = np.empty_like(valid) if number else valid
            kernels.resample_rows(
                band,
                self._holes(band),
                places.places,
                places.node_step,
                first_col,
                float(origin[0]),
                float(origin[1]),
                METHODS[self.method],
                samples.LANCZOS_TABLE,
                *limits,
                target,
                seen,
            )
            self._keep_apart(target, seen)
            if number:
                valid &= seen
        return out, valid

    def at(
        self, image: Pixels, line: Pixels, sample: Pixels, origin: tuple[int, int] = (0, 0)
    ) -> tuple[Pixels, FlagArray]:
        """Values (bands, rows, cols) at `line`, `sample` (rows, cols), as `rows`."""
        if image.dtype == np.int16:
            return self._signed(
                image, lambda sampler, raised: sampler.at(raised, line, sample, origin)
            )
        out, valid = _empty(image, line.shape)
        for number, (band, target) in enumerate(zip(image, out, strict=True)):
            seen = np.empty_like(valid) if number else valid
            self._places(band, (line, sample), origin, target, seen)
            self._keep_apart(target, seen)
            if number:
                valid &= seen
        return out, valid

    def _places(
        self,
        band: Pixels,
        places: tuple[Pixels, Pixels],
        origin: tuple[int, int],
        out: Pixels,
        seen: FlagArray,
    ) -> None:
        method, holes = METHODS[self.method], self._holes(band)
        first, lanczos = (float(origin[0]), float(origin[1])), samples.LANCZOS_TABLE
        nodata, has_nodata, low, high, half, fill = self._limits(band.dtype)
        words = None if holes.size else words_of(band, method)
        if words is None:
            resample_places(
                band, holes, *places, *first, method, lanczos, nodata, has_nodata, low, high,
                half, fill, out, seen,
            )  # fmt: skip
        else:
            resample_gathered(
                band, words, bits_of(band, words), *places, first, method, lanczos, nodata,
                has_nodata, low, high, fill, out, seen,
            )  # fmt: skip

    def _signed(
        self, image: Pixels, work: Callable[[Resampler, Pixels], tuple[Pixels, FlagArray]]
    ) -> tuple[Pixels, FlagArray]:
        """Let `work` have signed numbers raised to unsigned ones: only those round by a cut."""
        self._limits(image.dtype)
        nodata = None if self.nodata is None else self.nodata + float(_SIGN)
        pixels, valid = work(Resampler(self.method, nodata), image.view(np.uint16) ^ _SIGN)
        signed: Pixels = (pixels ^ _SIGN).view(np.int16)
        if nodata is None:
            signed[:, valid == 0] = 0
        return signed, valid

    def fill(self, dtype: DTypeLike) -> float:
        """Value of pixels of `dtype` that are not seen."""
        if self.nodata is not None:
            return self.nodata
        return float("nan") if np.dtype(dtype).kind == "f" else 0.0

    def _limits(self, dtype: np.dtype[Any]) -> tuple[float, bool, float, float, float, float]:
        """Nodata and whether there is one; lowest, highest, what rounds, what fills."""
        nodata, fill = self.nodata, self.fill(dtype)
        if dtype.kind == "f":
            big = float(np.finfo(np.float32).max)
            return nodata or 0.0, nodata is not None, -big, big, 0.0, fill
        low, high = float(np.iinfo(dtype).min), float(np.iinfo(dtype).max)
        if nodata is not None and not low <= nodata <= high:
            raise ArgumentError(f"nodata: a value of {dtype} expected, got {nodata:g}")
        if nodata == low:
            low += 1.0
        elif nodata == high:
            high -= 1.0
        return nodata or 0.0, nodata is not None, low, high, 0.5, fill

    def _holes(self, band: Pixels) -> FlagArray:
        if self.nodata is None and band.dtype.kind != "f":
            return np.empty((0, 0), dtype=np.uint8)
        size = tuple(-(-n // kernels.BLOCK) for n in band.shape)
        holes = np.empty(size, dtype=np.uint8)
        kernels.find_holes(band, self.nodata or 0.0, self.nodata is not None, holes)
        return holes if holes.any() else np.empty((0, 0), dtype=np.uint8)

    def _keep_apart(self, out: Pixels, valid: FlagArray) -> None:
        """Move values that have become `nodata` by chance to their neighbour."""
        if self.nodata is None or self.method == "nearest" or out.dtype.kind == "f":
            return
        if self.nodata in (np.iinfo(out.dtype).min, np.iinfo(out.dtype).max):
            return
        out[(out == self.nodata) & (valid != 0)] += 1


def _empty(image: Pixels, shape: tuple[int, ...]) -> tuple[Pixels, FlagArray]:
    if image.ndim != 3 or image.dtype.name not in PIXEL_TYPES:
        raise ArgumentError(
            f"resampling: bands of {', '.join(PIXEL_TYPES)} expected, got {image.ndim} "
            f"dimensions of {image.dtype}"
        )
    if not image.flags.c_contiguous:
        raise ArgumentError("resampling: a contiguous image expected")
    return np.empty((len(image), *shape), dtype=image.dtype), np.empty(shape, dtype=np.uint8)
