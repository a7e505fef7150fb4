"""Cloud-optimised GeoTIFFs: GDAL reads back what was written, and finds the layout it asks for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st

from geoposition.errors import ArgumentError
from geoposition.reimage import tiff_layout
from geoposition.reimage.cog import Layout, written_cog
from geoposition.reimage.lzw_kernels import lzw

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

TRANSFORM = (3e5, 0.5, 0.0, 7e6, 0.0, -0.5)


def pixels_of(dtype: str, bands: int, shape: tuple[int, int]) -> np.ndarray:
    lowest = 0 if dtype.startswith("u") else -90
    rng = np.random.default_rng(1)
    smooth = np.cumsum(rng.integers(-2, 3, (bands, *shape)), axis=2) % 150 + lowest
    return smooth.astype(dtype)


def written(path: Path, pixels: np.ndarray, layout: Layout, rows: int, **more: str) -> None:
    with written_cog(path, layout, **more) as file:  # type: ignore[arg-type]
        for first in range(0, pixels.shape[1], rows):
            file.write(pixels[:, first : first + rows])


@pytest.mark.parametrize("compression", ["none", "deflate", "lzw", "zstd"])
@pytest.mark.parametrize(
    ("dtype", "bands", "shape"),
    [("uint8", 3, (513, 700)), ("int16", 1, (700, 300)), ("uint16", 2, (1100, 1030)),
     ("float32", 1, (600, 1025))],
)  # fmt: skip
def test_gdal_reads_what_was_written(
    tmp_path: Path, dtype: str, bands: int, shape: tuple[int, int], compression: str
) -> None:
    pixels = pixels_of(dtype, bands, shape)
    layout = Layout(
        shape, bands, dtype, 7, "EPSG:32740", TRANSFORM, tags={"WORD": "said"},
        bands_named=("first",),
    )  # fmt: skip
    path = tmp_path / "made.tif"
    written(path, pixels, layout, 333, compression=compression)
    with rasterio.open(path) as file:
        assert np.array_equal(file.read(), pixels)
        assert file.crs.to_epsg() == 32740
        assert file.transform.to_gdal() == TRANSFORM
        assert file.nodata == 7
        assert file.tags()["WORD"] == "said"
        assert file.descriptions[0] == "first"
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        factors = file.overviews(1)
        assert factors == [2 ** (k + 1) for k in range(len(factors))]
        assert max(shape) / 2 ** len(factors) <= 512
        # the smallest overview's tiles come first, the image's last
        starts = [int(file.get_tag_item("BLOCK_OFFSET_0_0", "TIFF", bidx=1))]
        starts += [
            int(file.get_tag_item("BLOCK_OFFSET_0_0", "TIFF", bidx=1, ovr=k))
            for k in range(len(factors))
        ]
        assert starts == sorted(starts, reverse=True)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_overviews_are_means_and_keep_the_mean(tmp_path: Path, dtype: str) -> None:
    pixels = pixels_of(dtype, 1, (1024, 2048))
    path = tmp_path / "made.tif"
    written(path, pixels, Layout((1024, 2048), 1, dtype), 512)
    with rasterio.open(path) as file:
        half = file.read(1, out_shape=(512, 1024)).astype(float)
        quarter = file.read(1, out_shape=(256, 512)).astype(float)
    exact = pixels[0].astype(float).reshape(512, 2, 1024, 2).mean(axis=(1, 3))
    assert np.abs(half - exact).max() <= (1e-4 if dtype == "float32" else 0.5)
    # halves are rounded to even: no drift from level to level
    assert abs(quarter.mean() - pixels.mean()) < 0.005


def test_missing_pixels_stay_out_of_overviews(tmp_path: Path) -> None:
    pixels = np.full((1, 1030, 520), 100, dtype=np.uint16)
    pixels[0, ::2, ::2] = 0
    pixels[0, :8, :8] = 0
    path = tmp_path / "made.tif"
    written(path, pixels, Layout((1030, 520), 1, "uint16", 0), 1030)
    with rasterio.open(path) as file:
        half = file.read(1, out_shape=(515, 260))
    assert np.all(half[:4, :4] == 0)
    assert np.all(half[4:] == 100)
    codes = np.arange(1030 * 520, dtype=np.uint8).reshape(1, 1030, 520) % 9
    written(path, codes, Layout((1030, 520), 1, "uint8"), 1030, overviews="nearest")
    with rasterio.open(path) as file:
        assert np.array_equal(file.read(1, out_shape=(515, 260)), codes[0, ::2, ::2])


def test_a_large_file_is_a_bigtiff(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiff_layout, "_MOST_CLASSIC", 1000)
    pixels = pixels_of("uint16", 1, (1300, 700))
    path = tmp_path / "made.tif"
    written(path, pixels, Layout((1300, 700), 1, "uint16", None, "EPSG:32740", TRANSFORM), 512)
    assert path.read_bytes()[:4] == b"II+\0"
    with rasterio.open(path) as file:
        assert np.array_equal(file.read(), pixels)
        assert file.crs.to_epsg() == 32740
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.overviews(1) == [2, 4]


def test_rows_that_do_not_fit_are_refused_and_leave_nothing(tmp_path: Path) -> None:
    layout = Layout((600, 100), 1, "uint16")
    with (
        pytest.raises(ArgumentError, match="600 rows"),
        written_cog(tmp_path / "a.tif", layout) as f,
    ):
        f.write(np.zeros((1, 512, 100), np.uint16))
    with (
        pytest.raises(ArgumentError, match="rows of"),
        written_cog(tmp_path / "a.tif", layout) as f,
    ):
        f.write(np.zeros((1, 600, 99), np.uint16))
    assert list(tmp_path.iterdir()) == []


@settings(max_examples=60)
@given(st.binary(min_size=1, max_size=3000), st.integers(1, 40))
def test_lzw_codes_decode_to_what_they_were_made_of(content: bytes, repeat: int) -> None:
    """Decoded here by the book: TIFF 6.0, section 13."""
    told = np.frombuffer(content * repeat, np.uint8)
    assert decoded(bytes(lzw(told))) == told.tobytes()


def decoded(coded: bytes) -> bytes:
    stream, total = int.from_bytes(coded, "big"), 8 * len(coded)
    out, table, width, at, last = bytearray(), [], 9, 0, b""
    while True:
        code = (stream >> (total - at - width)) & ((1 << width) - 1)
        at += width
        if code == 257:
            assert total - at < 8
            return bytes(out)
        if code == 256:
            table, width, last = [bytes([k]) for k in range(256)] + [b"", b""], 9, b""
            continue
        word = table[code] if code < len(table) else last + last[:1]
        if last:
            table.append(last + word[:1])
        out += word
        last = word
        width = 9 + (len(table) >= 511) + (len(table) >= 1023) + (len(table) >= 2047)
