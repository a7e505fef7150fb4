"""Projected coordinates and geoid heights: authority numbers, PROJ itself, odd input."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

from geoposition.datum import Geoid, from_crs, to_crs, utm_epsg
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ArgumentError, MissingFileError, ProductError


def radians(lon_deg: float, lat_deg: float, height_m: float = 0.0) -> np.ndarray:
    return np.array([np.radians(lon_deg), np.radians(lat_deg), height_m])


# Coordinate reference systems


def test_utm_authority_numbers() -> None:
    # On the central meridian: 500 km east, 0.9996 times the meridian arc (NIMA TM8358.2).
    assert to_crs(32631, radians(3.0, 0.0, 7.0)) == pytest.approx([500000.0, 0.0, 7.0], abs=1e-6)
    quarter_m = 10001965.7293
    north = to_crs("EPSG:32631", radians(3.0, 84.0))[1] / 0.9996
    rest_m = 6_399_593.6258 * np.radians(6.0)
    assert quarter_m - north == pytest.approx(rest_m, rel=2e-4)
    assert to_crs("EPSG:32731", radians(3.0, -1e-9))[1] == pytest.approx(1e7, abs=1e-3)


def test_geocentric_and_geographic_systems() -> None:
    points = np.stack([radians(10.0, 50.0, 100.0), radians(-70.0, -33.0, 4000.0)])
    assert to_crs("EPSG:4978", points) == pytest.approx(geodetic_to_ecef(points), abs=1e-8)
    assert to_crs("EPSG:4326", points)[0] == pytest.approx([10.0, 50.0, 100.0], abs=1e-13)


@given(st.floats(-179.0, 179.0), st.floats(-79.0, 83.0), st.floats(-400.0, 9000.0))
def test_utm_round_trip(lon_deg: float, lat_deg: float, height_m: float) -> None:
    point = radians(lon_deg, lat_deg, height_m)
    epsg = utm_epsg(point[0], point[1])
    easting, northing, height = to_crs(epsg, point)
    assert 1e5 < easting < 9e5
    assert 0.0 <= northing <= 1e7
    back = from_crs(epsg, [easting, northing, height])
    assert np.abs((back - point) * [6.4e6, 6.4e6, 1.0]).max() < 1e-6


@pytest.mark.parametrize(
    ("lon_deg", "lat_deg", "epsg"),
    [
        (3.0, 44.0, 32631),
        (5.3, 60.4, 32632),
        (2.9, 60.4, 32631),
        (15.0, 78.0, 32633),
        (8.9, 78.0, 32631),
        (9.0, 78.0, 32633),
        (41.0, 78.0, 32637),
        (-180.0, -10.0, 32701),
        (180.0, 10.0, 32601),
        (179.999, 10.0, 32660),
        (364.0, 10.0, 32631),
        (55.5, -21.1, 32740),
    ],
)
def test_utm_zones(lon_deg: float, lat_deg: float, epsg: int) -> None:
    assert utm_epsg(np.radians(lon_deg), np.radians(lat_deg)) == epsg


def test_utm_ends_near_the_poles() -> None:
    for lat_deg in (85.0, -81.0, np.nan):
        with pytest.raises(ArgumentError, match="UTM"):
            utm_epsg(0.0, np.radians(lat_deg))


@pytest.mark.parametrize(
    "crs", ["EPSG:999999", "no such system", "", "EPSG:5773", "EPSG:32631+5773", "EPSG:9518"]
)
def test_unknown_or_unreachable_systems_are_refused(crs: str) -> None:
    """Among them heights above a geoid, which PROJ would pass through unchanged."""
    with pytest.raises(ArgumentError) as caught:
        to_crs(crs, radians(3.0, 44.0))
    assert "\n" not in str(caught.value)


def test_points_without_an_answer_are_nan_and_spare_the_others() -> None:
    found = to_crs(32631, np.stack([radians(3.0, 44.0), [np.nan, 0.7, 0.0]]))
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[1]).all()
    assert np.isnan(from_crs(32631, [1e12, 1e13, 0.0])).all()


def test_the_network_stays_off() -> None:
    code = (
        "import pyproj.network as n; from geoposition.datum import to_crs;"
        "to_crs(32631, [0.05, 0.7, 0.0]); assert not n.is_network_enabled()"
    )
    environment = {**os.environ, "PROJ_NETWORK": "ON"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


# Geoid


def write_grid(
    path: Path, values: np.ndarray, west: float, north: float, step: float, **kw
) -> Path:  # type: ignore[no-untyped-def]
    """A grid whose first node (row 0, column 0) is at (`west`, `north`) degrees."""
    profile = {
        "driver": "GTiff",
        "height": values.shape[0],
        "width": values.shape[1],
        "count": 1,
        "dtype": "float32",
        "crs": "EPSG:4326",
        "transform": Affine(step, 0.0, west - step / 2, 0.0, -step, north + step / 2),
        **kw,
    }
    with rasterio.open(path, "w", **profile) as raster:
        raster.write(values.astype(np.float32), 1)
    return path


def test_egm96_is_projs(real_data: Path) -> None:
    path = real_data / "dem" / "egm96_15.gtx"
    geoid = Geoid.from_file(path)
    assert geoid.wraps
    rng = np.random.default_rng(1)
    lon_deg = np.concatenate([rng.uniform(-180, 180, 5000), [-180, 180, 179.9, -179.9, 0, 12]])
    lat_deg = np.concatenate([rng.uniform(-90, 90, 5000), [0, 10, 20, -20, 90, -90]])
    pipeline = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f"+step +proj=vgridshift +grids={path} +multiplier=1 "
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    theirs = pipeline.transform(lon_deg, lat_deg, np.zeros(lon_deg.shape))[2]
    points = np.radians(np.stack([lon_deg, lat_deg], axis=-1))
    assert np.abs(geoid.undulation_m(points) - theirs).max() < 1e-9
    turned = points + np.array([2 * np.pi, 0.0])
    assert np.abs(geoid.undulation_m(turned) - theirs).max() < 1e-9


def test_egm96_authority_numbers(real_data: Path) -> None:
    """The six test points NGA published with EGM96; bilinear in 15' leaves centimetres."""
    geoid = Geoid.from_file(real_data / "dem" / "egm96_15.gtx")
    published = [
        (38.6281550, 269.7791550, -31.628),
        (-14.6212170, 305.0211140, -2.969),
        (46.8743190, 102.4487290, -43.575),
        (-23.6174460, 133.8747120, 15.871),
        (38.6254730, 359.9995000, 50.066),
        (-0.4667440, 0.0023000, 17.329),
    ]
    for lat_deg, lon_deg, undulation_m in published:
        found = geoid.undulation_m(radians(lon_deg, lat_deg))
        assert float(found) == pytest.approx(undulation_m, abs=0.07)


def test_bilinear_is_exact_on_a_bilinear_field_and_nan_outside(tmp_path: Path) -> None:
    lon_deg, lat_deg = np.meshgrid(np.arange(5.0, 8.25, 0.25), np.arange(46.0, 43.9, -0.25))
    field = 3.0 + 2.0 * lon_deg - 1.0 * lat_deg + 0.5 * lon_deg * lat_deg
    geoid = Geoid.from_file(write_grid(tmp_path / "g.tif", field, 5.0, 46.0, 0.25))
    assert not geoid.wraps
    points = np.random.default_rng(2).uniform([5.0, 44.0], [8.0, 46.0], (500, 2))
    expected = 3.0 + 2.0 * points[:, 0] - points[:, 1] + 0.5 * points[:, 0] * points[:, 1]
    assert np.abs(geoid.undulation_m(np.radians(points)) - expected).max() < 2e-5
    corners = np.radians([[5.0, 44.0], [8.0, 46.0], [5.0, 46.0], [8.0, 44.0]])
    assert np.isfinite(geoid.undulation_m(corners)).all()
    outside = np.radians([[4.99, 45.0], [8.01, 45.0], [6.0, 43.99], [6.0, 46.01], [np.nan, 45.0]])
    assert np.isnan(geoid.undulation_m(outside)).all()


def test_a_global_grid_from_0_to_360_wraps(tmp_path: Path) -> None:
    columns = np.arange(0.0, 360.0, 5.0)
    values = np.broadcast_to(np.cos(np.radians(columns)), (37, 72))
    geoid = Geoid.from_file(write_grid(tmp_path / "g.tif", values, 0.0, 90.0, 5.0))
    found = geoid.undulation_m(np.radians([[-2.5, 0.0], [357.5, 0.0], [2.5, 0.0], [-180.0, 0.0]]))
    mean = (1.0 + np.cos(np.radians(5.0))) / 2
    assert found == pytest.approx([mean, mean, mean, -1.0], abs=1e-7)


def test_holes_are_nan(tmp_path: Path) -> None:
    values = np.full((5, 5), 40.0)
    values[2, 2] = -9999.0
    geoid = Geoid.from_file(write_grid(tmp_path / "g.tif", values, 0.0, 4.0, 1.0, nodata=-9999.0))
    found = geoid.undulation_m(np.radians([[1.5, 1.5], [0.5, 3.5]]))
    assert np.isnan(found[0])
    assert found[1] == pytest.approx(40.0)


def test_heights_there_and_back(tmp_path: Path) -> None:
    geoid = Geoid.from_file(write_grid(tmp_path / "g.tif", np.full((5, 5), 47.5), 0.0, 4.0, 1.0))
    orthometric = np.stack([radians(1.2, 2.3, 100.0), radians(50.0, 2.0, 100.0)])
    ellipsoidal = geoid.ellipsoidal_from_orthometric(orthometric)
    assert ellipsoidal[0, 2] == pytest.approx(147.5)
    assert np.isnan(ellipsoidal[1, 2])
    assert orthometric[0, 2] == 100.0
    back = geoid.orthometric_from_ellipsoidal(ellipsoidal)
    assert back[0] == pytest.approx(orthometric[0])


def test_files_that_are_no_geoid_grid(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError):
        Geoid.from_file(tmp_path / "absent.gtx")
    text = tmp_path / "text.gtx"
    text.write_text("not a grid")
    with pytest.raises(ProductError, match="raster"):
        Geoid.from_file(text)
    utm = write_grid(tmp_path / "utm.tif", np.ones((4, 4)), 5e5, 5e6, 90.0, crs="EPSG:32631")
    with pytest.raises(ProductError, match="longitude and latitude"):
        Geoid.from_file(utm)
    far = write_grid(tmp_path / "far.tif", np.ones((4, 4)), 0.0, 500.0, 1.0)
    with pytest.raises(ProductError, match="degrees"):
        Geoid.from_file(far)
    geoid = Geoid.from_file(write_grid(tmp_path / "ok.tif", np.ones((4, 4)), 0.0, 4.0, 1.0))
    with pytest.raises(ArgumentError):
        geoid.undulation_m([1.0])
