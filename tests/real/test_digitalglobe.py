"""DigitalGlobe products: the rigorous model against the maker's own RPC and corners."""

from __future__ import annotations

import time
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from test_reader_digitalglobe import as_text_set

from geoposition.corrections import ALL_CORRECTIONS
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ProductError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.readers import digitalglobe
from geoposition.sensors.readers.digitalglobe_image import parse_image
from geoposition.sensors.readers.digitalglobe_model import body_covariance_rad2
from geoposition.sensors.readers.digitalglobe_support import (
    parse_attitude,
    parse_camera,
    parse_ephemeris,
)
from geoposition.sensors.readers.digitalglobe_tree import read_xml_tree
from geoposition.sensors.readers.source import Source

WORLDVIEW_2_1 = "linescan/worldview2_pair/wv_mvp_1.xml"
WORLDVIEW_2_2 = "linescan/worldview2_pair/wv_mvp_2.xml"
WORLDVIEW_1 = (
    "linescan/worldview1_tile/"
    "WV01_20210201005130_10200100A1865800_21FEB01005130-P1BS-016263048010_01_P001.xml"
)
WORLDVIEW_3 = "linescan/worldview3_csm/1040010074793300.xml"
ALL = [WORLDVIEW_2_1, WORLDVIEW_2_2, WORLDVIEW_1, WORLDVIEW_3]
SENSORS = ["WorldView-2", "WorldView-2", "WorldView-1", "WorldView-3"]

# Standard deviations (line, sample) of an independent model against the same RPCs, plus 0.01 px:
# attitude motion that a ratio of cubics cannot follow.
RPC_STD_PX = {
    WORLDVIEW_2_1: (0.07, 0.11),
    WORLDVIEW_2_2: (0.08, 0.23),
    WORLDVIEW_1: (0.08, 0.05),
}


def read(path: Path) -> Product:
    source = Source.of(path)
    assert digitalglobe.recognises(source)
    return digitalglobe.read(source)


def model_of(product: Product) -> PushbroomModel:
    assert isinstance(product.model, PushbroomModel)
    return product.model


def grid(model: PushbroomModel, n: int = 21) -> tuple[np.ndarray, np.ndarray]:
    lines, samples = model.shape
    line, sample, height = np.meshgrid(
        np.linspace(0, lines - 1, n),
        np.linspace(0, samples - 1, n),
        np.linspace(*model.height_range_m, 5),
        indexing="ij",
    )
    return np.stack([line, sample], axis=-1), height


@pytest.mark.parametrize("name", RPC_STD_PX)
def test_against_the_vendor_rpc(real_data: Path, name: str) -> None:
    product = read(real_data / name)
    model = model_of(product)
    assert product.vendor_rpc is not None
    assert model.height_range_m == product.vendor_rpc.height_range_m
    image, height = grid(model)
    ground = model.image_to_ground(image, height)
    assert not ground.flag.any()
    error = product.vendor_rpc.ground_to_image(ground.geodetic).image_px - image
    error = error.reshape(-1, 2)
    assert np.all(np.abs(error.mean(axis=0)) <= 0.10)
    assert np.all(error.std(axis=0) <= RPC_STD_PX[name])
    # The scatter depends on the line alone: what is left in sample and height is far smaller.
    per_line = error.reshape(21, -1, 2)
    assert np.all((per_line - per_line.mean(axis=1, keepdims=True)).std(axis=(0, 1)) < 0.02)


@pytest.mark.parametrize("name", RPC_STD_PX)
def test_stated_corners(real_data: Path, name: str) -> None:
    product = read(real_data / name)
    lines, samples = product.model.shape
    corners = product.details["corners_deg_m"]
    assert isinstance(corners, dict)
    pixels = {"UL": (0, 0), "UR": (0, samples - 1), "LR": (lines - 1, samples - 1)}
    pixels["LL"] = (lines - 1, 0)
    for corner, pixel in pixels.items():
        lon_deg, lat_deg, height_m = corners[corner]
        ground = product.model.image_to_ground(pixel, height_m).geodetic
        stated = [np.radians(lon_deg), np.radians(lat_deg), height_m]
        apart = np.linalg.norm(geodetic_to_ecef(ground) - geodetic_to_ecef(np.array(stated)))
        assert apart < 0.06, corner


@pytest.mark.parametrize(("name", "sensor"), list(zip(ALL, SENSORS, strict=True)))
def test_round_trip_and_facts(real_data: Path, name: str, sensor: str) -> None:
    product = read(real_data / name)
    model = model_of(product)
    assert product.sensor == sensor
    assert model.corrections == ALL_CORRECTIONS
    assert product.start is not None
    assert "notes" not in product.details
    assert product.details["catalogue_id"]
    image, height = grid(model)
    back = model.ground_to_image(model.image_to_ground(image, height).geodetic)
    assert np.max(np.abs(back.image_px - image)) < 1e-5


@pytest.mark.parametrize("name", [WORLDVIEW_2_1, WORLDVIEW_3])
def test_text_set_of_the_same_product(real_data: Path, tmp_path: Path, name: str) -> None:
    xml = read(real_data / name)
    isd = ET.parse(real_data / name).getroot()
    text = read(as_text_set(isd, tmp_path, Path(name).stem))
    image, height = grid(model_of(xml), 9)
    np.testing.assert_allclose(
        text.model.image_to_ground(image, height).geodetic,
        xml.model.image_to_ground(image, height).geodetic,
        rtol=0,
        atol=1e-15,
    )
    assert text.details == xml.details
    assert text.start == xml.start


@pytest.mark.parametrize("name", ALL)
def test_covariance_is_that_of_the_quaternion(real_data: Path, name: str) -> None:
    """A covariance of unit quaternions has no width along the quaternion itself.

    It vanishes there only if the ten numbers are the upper triangle, and in the order of the
    quaternion; it changes more slowly than the attitude, hence some 1 %.
    """
    rows = read_xml_tree(real_data / name).need("ATT").table("attList", 15)
    quat, upper = rows[:, 1:5], rows[:, 5:]
    C_q = np.zeros((len(rows), 4, 4))
    i, j = np.triu_indices(4)
    C_q[:, i, j] = C_q[:, j, i] = upper
    along = np.sqrt(np.abs(np.einsum("ni,nij,nj->n", quat, C_q, quat)))
    whole = np.sqrt(np.trace(C_q, axis1=1, axis2=2))
    assert np.median(along / whole) < 0.03
    scalar_first = quat[:, [3, 0, 1, 2]]
    along = np.sqrt(np.abs(np.einsum("ni,nij,nj->n", scalar_first, C_q, scalar_first)))
    assert np.median(along / whole) > 0.2
    turns = body_covariance_rad2(quat, upper)
    assert np.all(np.linalg.eigvalsh(turns) > 0)
    np.testing.assert_allclose(np.trace(turns, axis1=1, axis2=2), 4 * whole**2, rtol=2e-3)


def test_parsing_is_fast(real_data: Path) -> None:
    """Processor time, so that a busy machine does not count."""
    seconds = []
    for _ in range(3):
        start = time.process_time()
        isd = read_xml_tree(real_data / WORLDVIEW_2_1)
        parse_image(isd.need("IMD"))
        parse_ephemeris(isd.need("EPH"))
        parse_attitude(isd.need("ATT"))
        parse_camera(isd.need("GEO"), "P")
        seconds.append(time.process_time() - start)
    assert min(seconds) < 0.5


@pytest.mark.parametrize(
    ("old", "new", "tag"),
    [
        ("<NUMPOINTS>1318<", "<NUMPOINTS>1319<", "isd/EPH/EPHEMLIST"),
        ("<EPHEMLIST>7.0", "<EPHEMLIST>8.0", "isd/EPH/EPHEMLIST"),
        ("<ATTLIST>7.000000000000000e+00", "<ATTLIST>7.0 nan", "isd/ATT/ATTLIST: entry 7"),
        ("<TIMEINTERVAL>2.0", "<TIMEINTERVAL>-2.0", "isd/EPH/TIMEINTERVAL"),
        ("<TLCLIST>3.804", "<TLCLIST>-3.804", "isd/IMD/IMAGE/TLCLIST"),
        ("<PRODUCTLEVEL>Stereo 1B", "<PRODUCTLEVEL>", "isd/IMD/PRODUCTLEVEL"),
        ("<PD>", "<PD>about ", "isd/GEO/PRINCIPAL_DISTANCE/PD"),
        ("<QCS4>1", "<QCS4>0", "isd/GEO/CAMERA_ATTITUDE/QCS1"),
        ("</isd>", "", "line"),
    ],
)
def test_mutated(real_data: Path, tmp_path: Path, old: str, new: str, tag: str) -> None:
    text = (real_data / WORLDVIEW_2_1).read_text()
    assert old in text
    path = tmp_path / "wv.XML"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ProductError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: {tag}")
