"""CSM against asserted points of usgscsm and against a camera known from its own XML.

*Provenance.* DOI-USGS/usgscsm (public domain), tests/LineScanCameraTests.cpp at commit
4ae52c5fa6b4f3f52794e16231c5f3a8fa5a138f: points on the synthetic bodies, tolerances as there.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geoposition.corrections import NO_CORRECTIONS
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import UnsupportedError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.readers import csm, digitalglobe, dimap_v1, dimap_v2
from geoposition.sensors.readers.source import Source
from geoposition.sensors.writers.csm import write_csm

WV3 = "linescan/worldview3_csm/1040010074793300"


def sphere(centre: np.ndarray, direction: np.ndarray, radius_m: float) -> np.ndarray:
    """First point of a ray on a sphere, or, off the body, its point nearest to the centre."""
    along = -centre @ direction
    inside = radius_m**2 - (centre @ centre - along**2)
    return centre + (along - np.sqrt(max(inside, 0.0))) * direction


def test_constant_velocity_scanner(real_data: Path) -> None:
    scanner = csm.read_line_scanner(real_data / "linescan/csm/constVelocityLineScan.json")
    ground = sphere(*scanner.rays([7.5, 7.5]), 10.0)
    np.testing.assert_allclose(ground, [9.999995, 0.0, 0.009999995], atol=1e-10)
    # CSM line 0 lies before the tables: the velocity is constant, so the centre is known.
    (first, second), (direction, _) = scanner.rays([[0.0, 3.5], [1.0, 3.5]])
    off_body = sphere(first - 0.5 * (second - first), direction, 10.0)
    np.testing.assert_allclose(off_body, [0.0479968802, -7.99961602495, 16.00004799688], atol=1e-10)


def test_orbital_scanner(real_data: Path) -> None:
    path = real_data / "linescan/csm/orbitalLineScan.json"
    scanner = csm.read_line_scanner(path)
    ray = scanner.rays([8.0, 7.5])
    ground = sphere(*ray, 1e6)
    np.testing.assert_allclose(ground, [999999.67040488799, 0.0, -811.90523782723039], atol=1e-9)
    assert np.isclose(np.linalg.norm(sphere(*ray, 1000100.0)), 1000100.0, atol=1e-9)
    with pytest.raises(UnsupportedError, match="semi-axes 1000000 and 1000000 m"):
        csm.read(Source.of(path))


def test_worldview3_state_against_the_xml_of_the_same_camera(real_data: Path) -> None:
    state = csm.read(Source.of(real_data / f"{WV3}.json")).model
    xml = digitalglobe.read(Source.of(real_data / f"{WV3}.xml")).model
    assert state.shape == xml.shape
    line, sample = np.linspace(0, 38911, 41), np.linspace(0, 43007, 41)
    points = np.stack(np.meshgrid(line, sample, indexing="ij"), axis=-1).reshape(-1, 2)
    centres = state.rays(points, 0.0).origin_ecef_m - xml.rays(points, 0.0).origin_ecef_m
    assert np.max(np.linalg.norm(centres, axis=1)) < 1e-4
    ours, theirs = (geodetic_to_ecef(m.image_to_ground(points, 0.0).geodetic) for m in (xml, state))
    distance = np.linalg.norm(ours - theirs, axis=1)
    # The state's maker used another refraction formula.
    assert distance.mean() < 0.12
    assert distance.max() < 0.12


def read(path: Path) -> Product:
    source = Source.of(path)
    for reader in (digitalglobe, dimap_v2, dimap_v1):
        if reader.recognises(source):
            return reader.read(source)
    raise AssertionError(path)


PRODUCTS = [
    (f"{WV3}.xml", 1e-9),
    ("linescan/worldview2_pair/wv_mvp_1.xml", 1e-9),
    ("linescan/worldview2_pair/wv_mvp_2.xml", 1e-9),
    (
        "linescan/pleiades1a/IMG_PHR1A_P_001/DIM_PHR1A_P_202108271549303_SEN_5897098101-1.XML",
        1e-12,
    ),
    ("linescan/spot6/SPOT6.XML", 3e-10),
]


@pytest.mark.parametrize(("name", "bound_rad"), PRODUCTS)
def test_written_state_reads_back_to_the_same_rays(
    name: str, bound_rad: float, real_data: Path, tmp_path: Path
) -> None:
    model = read(real_data / name).model
    assert isinstance(model, PushbroomModel)
    report = write_csm(model, tmp_path / "state.json")
    back = csm.read(Source.of(tmp_path / "state.json")).model
    lines, samples = model.shape
    line, sample = np.linspace(-0.5, lines - 0.5, 211), np.linspace(-0.5, samples - 0.5, 21)
    points = np.stack(np.meshgrid(line, sample, indexing="ij"), axis=-1).reshape(-1, 2)
    ours, theirs = model.rays(points, report.height_m), back.rays(points, report.height_m)
    angle = np.linalg.norm(np.cross(ours.direction_ecef, theirs.direction_ecef), axis=1)
    assert np.max(angle) < bound_rad
    assert np.max(np.abs(ours.origin_ecef_m - theirs.origin_ecef_m)) < 2e-5
    assert report.max_angle_rad < bound_rad
    assert report.max_angle_px < 1.5e-3


def test_what_remains_is_the_aberrations_change_along_the_image(
    real_data: Path, tmp_path: Path
) -> None:
    name = "WV01_20210201005130_10200100A1865800_21FEB01005130-P1BS-016263048010_01_P001.xml"
    model = read(real_data / "linescan/worldview1_tile" / name).model
    # Fast pitching: the velocity along the line of sight changes by some 20 m/s in the scene.
    report = write_csm(model, tmp_path / "state.json", tolerance_rad=3e-10)
    assert 8e-10 < report.max_angle_rad < 1.3e-9
    bare = PushbroomModel(
        model.camera, model.ephemeris, model.attitude, NO_CORRECTIONS, model.height_range_m
    )
    assert write_csm(bare, tmp_path / "bare.json", tolerance_rad=3e-10).max_angle_rad < 3e-10
