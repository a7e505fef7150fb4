"""Calibration fields: what a folder says, the catalogue, synthetic ground."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geoposition.calib_fields.catalog import CATALOG, PUBLISHED, catalogued, fields_at
from geoposition.calib_fields.field import load_field
from geoposition.calib_fields.synthetic_dom import synthetic_dom
from geoposition.errors import ArgumentError, MissingFileError, ProductError
from geoposition.reimage.ortho import OrthoGrid

TEXT = """
name = "Hill"
epoch = "2020-05"
licence = "own"
height_datum = "EGM96"
[extent]
west = 10.0
south = 40.0
east = 11.0
north = 41.0
[dom]
files = ["dom*.tif"]
sigma_m = 0.5
[dem]
files = "dem.tif"
geoid = "geoid.gtx"
"""


def write_field(folder: Path, text: str = TEXT) -> Path:
    for name in ("dom1.tif", "dom2.tif", "dem.tif", "geoid.gtx"):
        (folder / name).write_bytes(b"")
    (folder / "field.toml").write_text(text, encoding="utf-8")
    return folder


def test_a_field_is_its_folder(tmp_path: Path) -> None:
    field = load_field(write_field(tmp_path))
    assert field.name == "Hill"
    assert [path.name for path in field.dom] == ["dom1.tif", "dom2.tif"]
    assert [path.name for path in field.dem] == ["dem.tif"]
    assert field.geoid == tmp_path / "geoid.gtx"
    assert field.dom_sigma_m == 0.5
    assert field.extent is not None
    assert field.extent.contains(10.5, 40.5)
    assert not field.extent.contains(9.5, 40.5)
    assert load_field(tmp_path / "field.toml") == field


@pytest.mark.parametrize(
    ("old", "new", "error", "words"),
    [
        ("dom*.tif", "other.tif", MissingFileError, "no such file"),
        ("sigma_m = 0.5", "sigma_m = -1", ProductError, "dom.sigma_m"),
        ("west = 10.0", "west = 12.0", ProductError, "extent"),
        ('name = "Hill"', "name = 3", ProductError, "name"),
        ('name = "Hill"', "name = ", ProductError, "TOML"),
        ('geoid = "geoid.gtx"', 'geoid = "none.gtx"', MissingFileError, "none.gtx"),
    ],
)
def test_a_wrong_entry_is_named(
    tmp_path: Path, old: str, new: str, error: type[Exception], words: str
) -> None:
    write_field(tmp_path, TEXT.replace(old, new))
    with pytest.raises(error, match=words):
        load_field(tmp_path)


def test_no_field_there(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError):
        load_field(tmp_path)


def test_catalogue_holds_the_paper_s_fields() -> None:
    assert {scene.region.lower() for scene in PUBLISHED} == set(CATALOG)
    for scene in PUBLISHED:
        assert scene.onboard_px == pytest.approx(np.hypot(*scene.onboard_rms_px), abs=1e-3)
        assert scene.compensated_px == pytest.approx(np.hypot(*scene.rms_px), abs=1e-3)
    assert catalogued("songshan") is catalogued("Songshan ")
    assert [field.name for field in fields_at(113.0, 34.5)] == ["Songshan"]
    with pytest.raises(ArgumentError, match="yili"):
        catalogued("Atlantis")


def test_synthetic_texture_is_repeatable_and_band_limited() -> None:
    grid = OrthoGrid("EPSG:32633", 0.0, 0.0, 1.0, (256, 300))
    dom = synthetic_dom(grid, seed=4)
    assert np.array_equal(dom.grey, synthetic_dom(grid, seed=4).grey)
    assert not np.array_equal(dom.grey, synthetic_dom(grid, seed=5).grey)
    window = np.hanning(256)[:, None] * np.hanning(300)
    power = np.abs(np.fft.fft2((dom.grey - dom.grey.mean()) * window)) ** 2
    k = np.hypot(np.fft.fftfreq(256)[:, None], np.fft.fftfreq(300)[None])
    assert power[k > 0.45].sum() < 1e-3 * power.sum()
    assert dom.grey.std() > 20.0
