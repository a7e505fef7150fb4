"""Cloud-optimised GeoTIFFs written in one pass: rows go in, tiles and overviews are coded at once.

Each overview is made from the rows of the level above it while they are at hand, tiles are coded
by all cores, and what is coded waits in unnamed files until the order on disk is known. So an
image is read and written once, and a row of tiles is all that is held of it.
"""

from __future__ import annotations

import tempfile
import warnings
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal, TypeAlias

import numba
import numpy as np
import pyarrow as pa
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from geoposition.errors import ArgumentError, ProductError
from geoposition.reimage import cog_kernels as kernels
from geoposition.reimage.lzw_kernels import lzw
from geoposition.reimage.tiff_layout import StoredLevel, Tags, assemble, directory_of, framed

Compression: TypeAlias = Literal["none", "deflate", "lzw", "zstd"]
Overviews: TypeAlias = Literal["average", "nearest", "none"]
Pixels: TypeAlias = NDArray[Any]

TILE: Final = 512

_TILE_ROWS_AHEAD: Final = 2
_LEVEL: Final = 1


@dataclass(frozen=True, slots=True)
class Layout:
    """What a raster to be written is like.

    `transform` are GDAL's six numbers, `rpc` an RPC as rasterio has it, `tags` and `bands_named`
    words for people.
    """

    shape: tuple[int, int]
    bands: int
    dtype: str
    nodata: float | None = None
    crs: str | None = None
    transform: tuple[float, ...] | None = None
    rpc: Any = None
    tags: Mapping[str, str] = field(default_factory=dict)
    bands_named: tuple[str, ...] = ()


@contextmanager
def written_cog(
    path: Path,
    layout: Layout,
    compression: Compression = "zstd",
    overviews: Overviews = "average",
) -> Iterator[CogWriter]:
    """Give a writer of `path`; the file is there when the block ends without an error.

    Compression is without loss, at its fastest level, with TIFF's predictor.
    """
    head = _head(path, layout)
    workers = numba.get_num_threads()
    with ExitStack() as stack:
        try:
            levels = [
                _Level(shape, stack.enter_context(tempfile.TemporaryFile(dir=path.parent)))
                for shape in _shapes(layout.shape, overviews)
            ]
            pool = stack.enter_context(ThreadPoolExecutor(workers, "tiles"))
            writer = CogWriter(layout, compression, overviews, levels, pool)
            try:
                yield writer
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
            writer.finish()
            stored = [StoredLevel(level.shape, level.data, level.sizes) for level in levels]
            assemble(path, head, stored, TILE, compression, writer.predictor)
        except OSError as error:
            raise ProductError(path, "", f"a writable place expected ({error.strerror})") from None


class CogWriter:
    """Takes an image's rows from the first to the last."""

    def __init__(
        self,
        layout: Layout,
        compression: Compression,
        overviews: Overviews,
        levels: list[_Level],
        pool: ThreadPoolExecutor,
    ) -> None:
        self._layout = layout
        self._dtype = np.dtype(layout.dtype)
        self._compression = compression
        self._overviews = overviews
        self._levels = levels
        self._pool = pool
        self._coded: deque[tuple[_Level, list[Future[Any]]]] = deque()

    @property
    def predictor(self) -> int:
        """TIFF's number of what is done to the values before they are compressed."""
        if self._compression == "none":
            return 1
        return 3 if self._dtype.kind == "f" else 2

    def write(self, pixels: Pixels) -> None:
        """Append the rows `pixels` (bands, rows, cols); they must not be changed afterwards."""
        bands, _, cols = pixels.shape
        if (bands, cols, pixels.dtype) != (self._layout.bands, self._layout.shape[1], self._dtype):
            raise ArgumentError(f"image file: rows of {self._layout} expected")
        self._push(0, pixels)

    def finish(self) -> None:
        """Code what is left; every row has to be there."""
        if self._levels[0].rows != self._layout.shape[0]:
            raise ArgumentError(
                f"image file: {self._layout.shape[0]} rows expected, got {self._levels[0].rows}"
            )
        while self._coded:
            self._store()

    def _push(self, number: int, pixels: Pixels) -> None:
        """Gather rows of a level into rows of tiles; code those, and make the next level's."""
        level, at = self._levels[number], 0
        while at < pixels.shape[1]:
            filled = level.rows % TILE
            most = min(TILE, level.shape[0] - level.rows + filled)
            whole: Pixels | None
            if filled == 0 and pixels.shape[1] - at >= most:
                whole = pixels[:, at : at + most]
                taken = most
            else:
                if filled == 0:
                    level.part = np.empty((len(pixels), most, level.shape[1]), self._dtype)
                taken = min(most - filled, pixels.shape[1] - at)
                level.part[:, filled : filled + taken] = pixels[:, at : at + taken]
                whole = level.part if filled + taken == most else None
            level.rows += taken
            at += taken
            if whole is not None:
                self._code(number, whole)

    def _code(self, number: int, pixels: Pixels) -> None:
        """Hand a row of tiles to the pool."""
        level = self._levels[number]
        tiles = [
            self._pool.submit(_coded_tile, pixels, col, self._compression)
            for col in range(0, level.shape[1], TILE)
        ]
        self._coded.append((level, tiles))
        if number + 1 < len(self._levels):
            self._push(number + 1, self._halved(pixels))
        while len(self._coded) > _TILE_ROWS_AHEAD:
            self._store()

    def _halved(self, pixels: Pixels) -> Pixels:
        if self._overviews == "nearest":
            return np.ascontiguousarray(pixels[:, ::2, ::2])
        bands, rows, cols = pixels.shape
        out = np.empty((bands, -(-rows // 2), -(-cols // 2)), self._dtype)
        nodata = self._layout.nodata
        known = nodata is not None and not np.isnan(nodata)
        if self._dtype.kind == "f":
            work: Callable[..., None] = kernels.halve_float
            value: float = float(nodata) if nodata is not None else 0.0
        else:
            work, value = kernels.halve_whole, int(nodata) if nodata is not None else 0
        work(pixels, value, known, out)
        return out

    def _store(self) -> None:
        level, tiles = self._coded.popleft()
        for tile in tiles:
            block = tile.result()
            before, after = framed(block)
            level.data.writelines((before, block, after))
            level.sizes.append(len(block))


@dataclass(slots=True, eq=False)
class _Level:
    """The image, or an overview, as far as it has come; `part` is the row of tiles begun."""

    shape: tuple[int, int]
    data: BinaryIO
    rows: int = 0
    part: Pixels = field(default_factory=lambda: np.empty((0, 0, 0)))
    sizes: list[int] = field(default_factory=list)


def _shapes(shape: tuple[int, int], overviews: Overviews) -> list[tuple[int, int]]:
    shapes = [shape]
    while overviews != "none" and max(shapes[-1]) > TILE:
        rows, cols = shapes[-1]
        shapes.append((-(-rows // 2), -(-cols // 2)))
    return shapes


def _coded_tile(pixels: Pixels, col: int, compression: Compression) -> Any:
    bands = len(pixels)
    tile = np.empty((TILE, TILE, bands), pixels.dtype)
    kernels.cut_tile(pixels, col, tile)
    if compression == "none":
        return tile.data.cast("B")
    if tile.dtype.kind == "f":
        planes = np.empty((TILE, 4 * TILE * bands), np.uint8)
        kernels.split_bytes(tile.view(np.uint32), planes)
        content = planes.reshape(-1)
    else:
        words = tile.view(np.uint8 if tile.itemsize == 1 else np.uint16)
        kernels.difference_rows(words)
        content = words.reshape(-1).view(np.uint8)
    if compression == "deflate":
        return zlib.compress(content.data, _LEVEL)
    if compression == "lzw":
        return lzw(content).data
    codec = pa.Codec("zstd", compression_level=_LEVEL)
    coded = codec.compress(pa.py_buffer(content))
    # Arrow's view of its buffer may reach past the end
    return memoryview(coded)[: coded.size]


def _head(path: Path, layout: Layout) -> Tags:
    """Let GDAL say in TIFF tags what `layout` says in words, in a file without pixels."""
    extra: dict[str, Any] = {}
    if layout.crs is not None:
        extra["crs"] = layout.crs
    if layout.transform is not None:
        extra["transform"] = rasterio.Affine.from_gdal(*layout.transform)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            with rasterio.MemoryFile() as memory:
                with memory.open(
                    driver="GTiff", width=TILE, height=TILE, count=layout.bands,
                    dtype=layout.dtype, nodata=layout.nodata, tiled=True, sparse_ok=True,
                    interleave="pixel", endianness="little", bigtiff="NO", **extra,
                ) as raster:  # fmt: skip
                    if layout.rpc is not None:
                        raster.rpcs = layout.rpc
                    if layout.tags:
                        raster.update_tags(**layout.tags)
                    for number, name in enumerate(layout.bands_named, 1):
                        if name:
                            raster.set_band_description(number, name)
                return directory_of(memory.read())
        except RasterioError as error:
            words = " ".join(str(error).split())
            raise ProductError(path, "", f"a raster of {layout} expected ({words})") from None
