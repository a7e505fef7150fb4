"""Vendors' RPC files: read, inverted, beside GDAL, the makers' own grids and direct models."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.rpc import RPC
from rasterio.transform import RPCTransformer

from geoposition.errors import ProductError, UnsupportedError
from geoposition.rpc.compare import compare
from geoposition.rpc.formats import DIALECTS, read_rpc, write_rpc
from geoposition.rpc.formats._fields import SCALAR_FIELDS
from geoposition.rpc.model import RpcModel

VENTOUX = "stereo/pleiades_ventoux"
VENTOUX_XML = f"{VENTOUX}/RPC_PHR1B_P_201308051042194_SEN_690908101-001.XML"
PLEIADES_1A = "linescan/pleiades1a/IMG_PHR1A_P_001/RPC_PHR1A_P_202108271549303_SEN_5897098101-1.XML"
SYSTEM = "grids/PHRDIMAP_P1BP--2018122638935449CP.XML"
GRID_RPC = "grids/RPC_P1BP--2017092838284574CP.XML"
WORLDVIEW_1 = (
    "linescan/worldview1_tile/"
    "WV01_20210201005130_10200100A1865800_21FEB01005130-P1BS-016263048010_01_P001.xml"
)

# Image size as the file (or, for DIMAP and text files, offset and scale) gives it.
FILES = {
    "rpc/20191015_073816_ssc1d3_0011_basic_l1a_panchromatic_dn_RPC.TXT": (1081, 2562),
    "rpc/rpc_IKONOS.txt": (10249, 12669),
    "rpc/rpc_PLANET_L1A.txt": (1082, 2562),
    "rpc/rpc_PLEIADES.xml": (36176, 40000),
    "rpc/rpc_SPOT6.xml": (24777, 21953),
    "rpc/rpc_WV2.xml": (20289, 28244),
    "rpc/rpc_WV3.xml": (23969, 35180),
    "stereo/pleiades_reunion/img_01.tif": (1024, 1024),
    "stereo/pleiades_reunion/img_02.tif": (1102, 1031),
    f"{VENTOUX}/left_image.geom": (41801, 39182),
    f"{VENTOUX}/right_image.geom": (40845, 38987),
    f"{VENTOUX}/right_image_bias.geom": (40845, 38987),
    f"{VENTOUX}/lowres_color_image.geom": (10451, 9796),
    f"{VENTOUX}/left_image.tif": (500, 500),
    f"{VENTOUX}/right_image.tif": (495, 498),
    VENTOUX_XML: (42248, 39208),
    GRID_RPC: (22940, 40000),
    SYSTEM: (38248, 40000),
    PLEIADES_1A: (15169, 32824),
    "linescan/worldview2_pair/wv_mvp_1.xml": (27968, 32837),
    "linescan/worldview2_pair/wv_mvp_2.xml": (23640, 35180),
    WORLDVIEW_1: (24344, 35180),
    "linescan/worldview3_csm/1040010074793300.xml": (38912, 43008),
    "dom/quickbird2_baviaanskloof/qb2_basic1b.tif": (1450, 850),
}


def random_pixels(model: RpcModel, n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    high = np.array(model.shape) - 0.5
    image = rng.uniform(-0.5, high, (n, 2))
    image[:4] = [[-0.5, -0.5], [-0.5, high[1]], [high[0], -0.5], high]
    return image, rng.uniform(*model.height_range_m, n)


@pytest.mark.parametrize("name", FILES)
def test_every_vendor_file_reads_and_inverts(name: str, real_data: Path) -> None:
    model = read_rpc(real_data / name)
    assert model.shape == FILES[name]
    image, height = random_pixels(model, 5000)
    ground = model.image_to_ground(image, height)
    back = model.ground_to_image(ground.geodetic)
    assert not ground.flag.any()
    assert not back.flag.any() or np.all(np.abs(back.image_px - image) < 1e-6)
    assert np.abs(back.image_px - image).max() < 1e-6
    high = model.image_to_ground(image, 6000.0)
    assert not high.flag.any()
    assert np.abs(model.ground_to_image(high.geodetic).image_px - image).max() < 1e-6


@pytest.mark.parametrize("name", FILES)
def test_every_vendor_file_converts_bit_for_bit(name: str, real_data: Path, tmp_path: Path) -> None:
    model = read_rpc(real_data / name)
    for dialect in DIALECTS:
        path = tmp_path / f"{dialect}.tif"
        write_rpc(model, path, dialect)
        back = read_rpc(path)
        for field in (*SCALAR_FIELDS.values(), "line_num", "line_den", "samp_num", "samp_den"):
            assert np.array_equal(getattr(back, field), getattr(model, field)), (dialect, field)


@pytest.mark.parametrize("name", FILES)
def test_gdal_finds_the_same_pixel_half_a_pixel_on(name: str, real_data: Path) -> None:
    model = read_rpc(real_data / name)
    image, height = random_pixels(model, 200)
    lon_deg, lat_deg = np.degrees(model.image_to_ground(image, height).geodetic[:, :2]).T
    scalars = {key.lower(): getattr(model, field) for key, field in SCALAR_FIELDS.items()}
    rpcs = RPC(
        **scalars, line_num_coeff=model.line_num.tolist(), line_den_coeff=model.line_den.tolist(),
        samp_num_coeff=model.samp_num.tolist(), samp_den_coeff=model.samp_den.tolist(),
    )  # fmt: skip
    with RPCTransformer(rpcs) as gdal:
        line, samp = gdal.rowcol(lon_deg, lat_deg, zs=height, op=lambda value: value)
    np.testing.assert_allclose(np.stack([line, samp], axis=1) - 0.5, image, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "limit_px"),
    # SPOT 6: the maker's own two models agree to 0.02 px only.
    [("rpc/rpc_PLEIADES.xml", 0.002), ("rpc/rpc_SPOT6.xml", 0.021), (SYSTEM, 0.002),
     (GRID_RPC, 0.002), (PLEIADES_1A, 0.001), (VENTOUX_XML, 0.002)],
)  # fmt: skip
def test_direct_and_inverse_coefficients_are_one_model(
    name: str, limit_px: float, real_data: Path
) -> None:
    model = read_rpc(real_data / name)
    image, height = random_pixels(model, 3000)
    back = model.ground_to_image(model.direct_image_to_ground(image, height)).image_px
    assert np.abs(back - image).max() < limit_px


@pytest.mark.parametrize(
    ("rpc", "grid", "layers"),
    [(GRID_RPC, "grids/GRID_P1BP--2017092838284574CP.tif", (0, 1)),
     (SYSTEM, "grids/GRID_P1BP--2018122638935449CP.tif", (1,))],
)  # fmt: skip
def test_the_producers_location_grids(
    rpc: str, grid: str, layers: tuple[int, ...], real_data: Path
) -> None:
    """The grids count from the first pixel's corner; this fixes the origin of DIMAP pixels."""
    model = read_rpc(real_data / rpc)
    with rasterio.open(real_data / grid) as source:
        values, transform, tags = source.read(), source.transform, source.tags()
    line_px = transform.f + transform.e * np.arange(values.shape[1]) - 0.5
    samp_px = transform.c + transform.a * np.arange(values.shape[2]) - 0.5
    nodes = np.stack(np.meshgrid(line_px, samp_px, indexing="ij"), axis=-1)
    for layer in layers:
        lon_deg, lat_deg = values[2 * layer], values[2 * layer + 1]
        height = np.full_like(lon_deg, float(tags[f"ALTITUDE_B{2 * layer}"]))
        geodetic = np.stack([np.radians(lon_deg), np.radians(lat_deg), height], axis=-1)
        difference = model.ground_to_image(geodetic).image_px - nodes
        # The known figure, at the digits it is known to; the fit's own rms is 0.001.
        assert round(float(np.abs(difference).max()), 3) <= 0.002


def test_keyword_list_and_dimap_of_one_scene_agree(real_data: Path) -> None:
    from_list = read_rpc(real_data / VENTOUX / "left_image.geom")
    from_xml = read_rpc(real_data / VENTOUX_XML)
    result = compare(from_list, from_xml)
    # The list holds 15 digits.
    assert max(result.row.max, result.col.max) < 1e-6
    assert result.points == 21 * 21 * 5


def test_the_planted_bias_comes_out(real_data: Path) -> None:
    honest = read_rpc(real_data / VENTOUX / "right_image.geom")
    planted = read_rpc(real_data / VENTOUX / "right_image_bias.geom")
    result = compare(honest, planted)
    assert result.row.mean == pytest.approx(60.0, abs=1e-6)
    assert result.row.max_without_mean < 1e-6
    assert result.col.max < 1e-6


def test_crops_have_their_own_pixels(real_data: Path) -> None:
    crop = read_rpc(real_data / VENTOUX / "left_image.tif")
    whole = read_rpc(real_data / VENTOUX / "left_image.geom")
    a = crop.image_to_ground([[0.0, 0.0], [499.0, 499.0]], 500.0).geodetic
    b = whole.image_to_ground([[5000.0, 5000.0], [5499.0, 5499.0]], 500.0).geodetic
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-14)


def test_tags_are_read_without_loss_of_digits(real_data: Path) -> None:
    path = real_data / "stereo/pleiades_reunion/img_01.tif"
    model = read_rpc(path)
    with rasterio.open(path) as source:
        rpcs = source.rpcs
    assert rpcs.line_off == pytest.approx(model.line_off_px, rel=1e-14)
    assert rpcs.samp_num_coeff == pytest.approx(model.samp_num.tolist(), rel=1e-13)


def test_what_cannot_be_used_is_refused(real_data: Path) -> None:
    with pytest.raises(UnsupportedError, match=r"rpc_unsupported\.xml: VRTDataset"):
        read_rpc(real_data / "rpc/rpc_unsupported.xml")
    for name in [
        "linescan/spot6/SPOT6.XML",
        "linescan/worldview3_csm/1040010074793300.json",
        "stereo/pleiades_reunion/expected_dsm.tif",
        "dom/quickbird2_baviaanskloof/rpc_param.yaml",
        "dom/quickbird2_baviaanskloof/gcps.geojson",
    ]:
        with pytest.raises(ProductError):
            read_rpc(real_data / name)
