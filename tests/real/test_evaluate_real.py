"""QuickBird-2 on Sentinel-2: the shift that ground control and an independent match gave."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geoposition.calib_fields.evaluate import evaluate
from geoposition.calib_fields.geometry import Dom
from geoposition.calib_fields.match import DomMatches, DomMatchOptions, match_dom
from geoposition.matching import open_image
from geoposition.rpc.model import RpcModel
from geoposition.scripts import cli
from geoposition.sensors.readers import open_product
from geoposition.terrain import RasterTerrain

FOLDER = "dom/quickbird2_baviaanskloof"
# The DEM's heights are EGM2008, the grid EGM96: they differ by about a metre here.
GEOID = "dem/egm96_15.gtx"


def matched(real_data: Path, shift_px: tuple[float, float]) -> tuple[DomMatches, RpcModel]:
    folder = real_data / FOLDER
    model = open_product(folder / "qb2_basic1b.tif").model
    assert isinstance(model, RpcModel)
    model = replace(
        model,
        line_off_px=model.line_off_px + shift_px[0],
        samp_off_px=model.samp_off_px + shift_px[1],
    )
    source = open_image(folder / "qb2_basic1b.tif", first_pixel=(0, 0))
    dom = Dom.open(folder / "sentinel2_b432_byte.tif")
    terrain = RasterTerrain(folder / "dem_egm2008.tif", real_data / GEOID)
    return match_dom(source, model, dom, terrain, DomMatchOptions()), model


@pytest.mark.parametrize(
    ("shift_px", "expected_m"),
    [((0.0, 0.0), (19.6, -8.5)), ((-2.09, -2.95), (0.3, 4.9))],
    ids=["as it came", "with ground control"],
)
def test_shift_against_sentinel(
    real_data: Path, shift_px: tuple[float, float], expected_m: tuple[float, float]
) -> None:
    matches, model = matched(real_data, shift_px)
    found = evaluate(matches, model)
    assert found.points >= 150
    for name, expected in zip(("bias_e_m", "bias_n_m"), expected_m, strict=True):
        assert found.estimates[name].value == pytest.approx(expected, abs=2.0)
        low, high = found.estimates[name].interval
        assert 0.1 < high - low < 4.0
    # the image's plane, as ground control says: observed less modelled
    assert np.allclose(
        [found.estimates["bias_line_px"].value, found.estimates["bias_sample_px"].value],
        np.array([-2.09, -2.95]) - shift_px,
        atol=1.0,
    )


def test_command(real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = real_data / FOLDER
    arguments = [
        "evaluate", str(folder / "qb2_basic1b.tif"),
        "--dom", str(folder / "sentinel2_b432_byte.tif"), "--dem", str(folder / "dem_egm2008.tif"),
    ]  # fmt: skip
    assert cli.run([*arguments, "-o", str(tmp_path / "none")]) == 2
    error = capsys.readouterr().err
    assert "geoid" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "none").exists()
    geoid = ["--geoid", str(real_data / GEOID)]
    assert cli.run([*arguments, *geoid, "-o", str(tmp_path / "out"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["points"] >= 150
    assert result["bias_e_m_interval"][0] < result["bias_e_m"] < result["bias_e_m_interval"][1]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "http://" not in page
    assert "https://" not in page
    assert "sha256" in page
