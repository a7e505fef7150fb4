"""Control and ties in the formats people have them: same points, same answers; hostile files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from geoposition.datum import to_crs
from geoposition.ellipsoid import enu_axes
from geoposition.errors import GeopositionError, ProductError
from geoposition.scripts.control_files import (
    ControlFile,
    Heights,
    covariance_enu_m2,
    geodetic_of,
    is_match_file,
    read_control_file,
    read_match_file,
)
from geoposition.scripts.image_names import ImageNames
from geoposition.scripts.tables import write_points
from geoposition.scripts.tie_tables import read_checks, read_named_ties, read_ties

LON, LAT, HEIGHT = (
    np.array([6.1, 6.2, 6.15]),
    np.array([44.1, 44.12, 44.2]),
    np.array([310.0, 520.5, 1200.25]),
)
IDS = ("a", "b", "c")
ROW, COL = np.array([10.25, 200.5, 333.0]), np.array([5.75, 81.0, 400.5])
CSV = "id,lon,lat,height\na,6.1,44.1,310\nb,6.2,44.12,520.5\nc,6.15,44.2,1200.25\n"
EGM96_RAISED_M = 50.0


def geodetic(found: ControlFile, heights: Heights | None = None) -> np.ndarray:
    assert found.ground is not None
    return geodetic_of(found.ground, heights or Heights())


def expected() -> np.ndarray:
    return np.column_stack([np.radians(LON), np.radians(LAT), HEIGHT])


def weighted(path: Path) -> np.ndarray:
    """Covariances of a file's points, all the way from its text."""
    found = read_control_file(path)
    points = geodetic(found)
    assert found.ground is not None
    return covariance_enu_m2(found.ground, points, 1.0)


def close(points: np.ndarray, truth: np.ndarray, tolerance_m: float = 1e-4) -> None:
    off = (points - truth) * [6.4e6, 6.4e6, 1.0]
    assert np.max(np.abs(off)) < tolerance_m


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


# Formats -------------------------------------------------------------------------------------


def test_csv_with_other_names_of_columns(tmp_path: Path) -> None:
    text = "Point,Longitude,Latitude,Elevation,line,sample,image\n" + "".join(
        f"{i},{x},{y},{h},{r},{c},left.tif\n"
        for i, x, y, h, r, c in zip(IDS, LON, LAT, HEIGHT, ROW, COL, strict=True)
    )
    found = read_control_file(written(tmp_path / "g.csv", text))
    close(geodetic(found), expected(), 1e-8)
    assert found.image is not None
    np.testing.assert_array_equal(found.image.image_px, np.column_stack([ROW, COL]))
    assert set(found.image.names) == {"left.tif"}


def test_one_point_in_two_images_is_one_point(tmp_path: Path) -> None:
    text = "id,lon,lat,height,product,row,col\na,6.1,44.1,310,l,1,2\na,6.1,44.1,310,r,3,4\n"
    found = read_control_file(written(tmp_path / "g.csv", text))
    assert found.ground is not None
    assert found.image is not None
    assert found.ground.ids.tolist() == ["a"]
    assert found.image.names.tolist() == ["l", "r"]


def test_columns_for_each_image(tmp_path: Path) -> None:
    text = "id,lon,lat,height,row_left,col_left,row_right,col_right\na,6.1,44.1,310,1,2,,\n"
    text += "b,6.2,44.12,520.5,3,4,5,6\n"
    image = read_control_file(written(tmp_path / "g.csv", text)).image
    assert image is not None
    assert sorted(zip(image.ids, image.names, image.image_px[:, 0], strict=True)) == [
        ("a", "left", 1.0), ("b", "left", 3.0), ("b", "right", 5.0),
    ]  # fmt: skip


def test_projected_coordinates_name_their_system(tmp_path: Path) -> None:
    utm = to_crs("EPSG:32632", expected())
    rows = "".join(
        f"{i},{p[0]!r},{p[1]!r},{p[2]!r}\n" for i, p in zip(IDS, utm.tolist(), strict=True)
    )
    path = written(tmp_path / "g.csv", "id,x,y,height\n" + rows)
    close(geodetic(read_control_file(path, "EPSG:32632")), expected())
    with pytest.raises(ProductError, match="coordinate system expected"):
        read_control_file(path)
    noted = written(tmp_path / "n.csv", "# crs: EPSG:32632\nid,x,y,height\n" + rows)
    close(geodetic(read_control_file(noted)), expected())


@pytest.mark.parametrize("name", ["g.geojson", "g.gpkg"])
def test_vector_layers(tmp_path: Path, name: str) -> None:
    columns = {"id": np.array(IDS), "lon": LON, "lat": LAT, "height": HEIGHT, "row": ROW,
               "col": COL, "sigma_u": np.array([0.1, 0.2, 0.3])}  # fmt: skip
    write_points(tmp_path / name, columns)
    found = read_control_file(tmp_path / name)
    close(geodetic(found), expected(), 1e-3)
    assert found.ground is not None
    assert found.image is not None
    np.testing.assert_allclose(found.image.image_px, np.column_stack([ROW, COL]))
    np.testing.assert_allclose(found.ground.sigma_m[:, 2], [0.1, 0.2, 0.3])


def test_vector_layers_with_columns_for_each_image(tmp_path: Path) -> None:
    columns = {"id": np.array(IDS), "lon": LON, "lat": LAT, "height": HEIGHT, "row_left": ROW,
               "col_left": COL}  # fmt: skip
    write_points(tmp_path / "g.geojson", columns)
    image = read_control_file(tmp_path / "g.geojson").image
    assert image is not None
    assert set(image.names.tolist()) == {"left"}
    np.testing.assert_allclose(image.image_px, np.column_stack([ROW, COL]))


def test_geojson_as_orthority_writes_it(tmp_path: Path) -> None:
    features = [
        {
            "type": "Feature",
            "properties": {"ji": [c, r], "filename": "q.tif", "id": i},
            "geometry": {"type": "Point", "coordinates": [x, y, h]},
        }
        for i, x, y, h, r, c in zip(IDS, LON, LAT, HEIGHT, ROW, COL, strict=True)
    ]
    text = json.dumps({"type": "FeatureCollection", "features": features})
    found = read_control_file(written(tmp_path / "g.geojson", text))
    close(geodetic(found), expected(), 1e-3)
    assert found.image is not None
    np.testing.assert_allclose(found.image.image_px, np.column_stack([ROW, COL]))
    assert found.image.names.tolist() == ["q.tif"] * 3


def test_asp_gcp_latitude_first_and_sigmas_along_ecef(tmp_path: Path) -> None:
    text = '# WKT: GEOGCS["WGS 84"]\n# id lat lon height sigma ...\n'
    text += "a 44.1 6.1 310 0.1 0.2 0.3 left.tif 5.75 10.25 0.5 0.25 right.tif 7 8 1 1\n"
    text += "b,44.12,6.2,520.5,1,1,1,left.tif,81.0,200.5,1,1\n"
    found = read_control_file(written(tmp_path / "g.gcp", text))
    points = geodetic(found)
    close(points, expected()[:2], 1e-8)
    assert found.ground is not None
    assert found.image is not None
    np.testing.assert_array_equal(found.image.image_px[0], [10.25, 5.75])
    np.testing.assert_array_equal(found.image.sigma_px[0], [0.25, 0.5])
    covariance = covariance_enu_m2(found.ground, points, 9.0)
    axes = enu_axes(points)
    back = axes[0] @ covariance[0] @ axes[0].T
    np.testing.assert_allclose(back, np.diag([0.01, 0.04, 0.09]), atol=1e-12)
    np.testing.assert_allclose(covariance[1], np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    "header", ["mapX,mapY,sourceX,sourceY,enable,dX,dY,residual", "mapX,mapY,pixelX,pixelY,enable"]
)
def test_qgis_points_count_from_the_corner_and_upwards(tmp_path: Path, header: str) -> None:
    """The centre of the first pixel is (0.5, -0.5) to QGIS."""
    rest = ",0,0,0" if "dX" in header else ""
    rows = [
        f"{x},{y},{c + 0.5},{-r - 0.5},{on}{rest}"
        for x, y, r, c, on in zip(LON, LAT, ROW, COL, (1, 0, 1), strict=True)
    ]
    text = "\n".join(["#CRS: EPSG:4326", header, *rows]) + "\n"
    found = read_control_file(written(tmp_path / "left.tif.points", text))
    assert found.ground is not None
    assert found.image is not None
    assert found.ground.ids.tolist() == ["0", "2"]
    np.testing.assert_allclose(found.image.image_px, np.column_stack([ROW, COL])[[0, 2]])
    assert found.image.names.tolist() == ["left.tif"] * 2
    with pytest.raises(ProductError, match=r"point 0: .*no height"):
        geodetic(found)


def test_heights_above_a_geoid_become_ellipsoidal(tmp_path: Path, geoid: Path) -> None:
    found = read_control_file(written(tmp_path / "g.csv", CSV))
    raised = expected() + [0.0, 0.0, EGM96_RAISED_M]
    close(geodetic(found, Heights(geoid=geoid)), raised)


@pytest.fixture(scope="module")
def geoid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a geoid 50 m above the ellipsoid everywhere."""
    import rasterio
    from rasterio.transform import from_origin

    path = tmp_path_factory.mktemp("geoid") / "flat.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=20, height=20, count=1, dtype="float32",
        crs="EPSG:4326", transform=from_origin(0.0, 50.0, 1.0, 1.0),
    ) as raster:  # fmt: skip
        raster.write(np.full((1, 20, 20), EGM96_RAISED_M, dtype=np.float32))
    return path


def test_matches_of_a_pair_as_asp_writes_them_out(tmp_path: Path) -> None:
    tail = "0 0 0.0 1.0 0.5 1 0 0 0"
    left = [f"{c} {r} {tail}" for r, c in zip(ROW, COL, strict=True)]
    right = [f"{c + 7} {r - 3} {tail}" for r, c in zip(ROW, COL, strict=True)]
    path = written(tmp_path / "run-l__r.txt", "\n".join(["3 3", *left, *right]) + "\n")
    assert is_match_file(path)
    a, b = read_match_file(path)
    np.testing.assert_allclose(a, np.column_stack([ROW, COL]))
    np.testing.assert_allclose(b - a, np.tile([-3.0, 7.0], (3, 1)))
    names = ImageNames(("r", "x", "l"), (Path("r.xml"), Path("x.xml"), Path("l.xml")))
    assert set(read_named_ties(path, names).product) == {0, 2}
    np.testing.assert_allclose(read_named_ties(path, names).image_px[:3], a)
    assert read_named_ties(path, names).product[0] == 2
    short = written(tmp_path / "s.match", "\n".join(["3 3", *left]) + "\n")
    with pytest.raises(ProductError, match="3 and 3 points announced, 3 lines found"):
        read_match_file(short)


def test_plain_matches_and_tables_tell_themselves_apart(tmp_path: Path) -> None:
    plain = written(tmp_path / "m.txt", "# col row col row\n5.75 10.25 12.75 7.25\n")
    ties = read_ties(plain, [Path("l.xml"), Path("r.xml")])
    np.testing.assert_allclose(ties.image_px, [[10.25, 5.75], [7.25, 12.75]])
    table = written(tmp_path / "t.txt", "id,product,row,col\np,l,1,2\np,r,3,4\n")
    assert not is_match_file(table)
    np.testing.assert_allclose(
        read_ties(table, [Path("l.xml"), Path("r.xml")]).image_px, [[1, 2], [3, 4]]
    )
    with pytest.raises(ProductError, match="two images, or a name"):
        read_ties(plain, [Path("l.xml"), Path("r.xml"), Path("x.xml")])


def test_checks_of_an_intersection_come_in_all_formats(tmp_path: Path) -> None:
    gcp = written(tmp_path / "g.gcp", "a 44.1 6.1 310 1 1 1\nb 44.12 6.2 520.5 1 1 1\n")
    found = read_checks(gcp)
    assert found.ids.tolist() == ["a", "b"]
    close(found.geodetic, expected()[:2], 1e-8)


# Hostile files -------------------------------------------------------------------------------

HOSTILE = {
    "no height column": ("g.csv", "id,lon,lat\na,6,44\n", "point a: .*no height"),
    "misspelt": ("g.csv", "id,lon,latt,height\na,6,44,1\n", "lat missing.*is it 'latt'"),
    "header only": ("g.csv", "id,lon,lat,height\n", "header only"),
    "empty": ("g.csv", "", "file is empty"),
    "nan": ("g.csv", "id,lon,lat,height\na,6,nan,1\n", "point a: lon, lat, height expected"),
    "word": ("g.csv", "id,lon,lat,height\na,6,44,high\n", "point a"),
    "twice": ("g.csv", "id,lon,lat,height\na,6,44,1\na,6,45,1\n", "point a: each id once"),
    "no id": ("g.csv", "id,lon,lat,height\n,6,44,1\n", "row 1: an id expected"),
    "metres": ("g.csv", "id,lon,lat,height\na,270000,4884000,1\n", "degrees expected.*crs"),
    "negative sigma": ("g.csv", "id,lon,lat,height,sigma_m\na,6,44,1,-2\n", "positive standard"),
    "gcp words": ("g.gcp", "a 44 6 310 1 1\n", "line 1: id lat lon height"),
    "gcp text": ("g.gcp", "a 44 6 310 1 1 x\n", "line 1: numbers expected"),
    "gcp twice": ("g.gcp", "a 44 6 1 1 1 1\na 44 6 1 1 1 1\n", "point a: each point once"),
    "gcp datum": ("g.gcp", '# WKT: GEOGCS["D_MOON"]\na 44 6 1 1 1 1\n', "another datum"),
    "gcp nothing": ("g.gcp", "# nothing\n", "there are none"),
    "points header": ("g.points", "mapX,mapY\n1,2\n", "sourceX, sourceY missing"),
    "points disabled": ("g.points", "mapX,mapY,sourceX,sourceY,enable\n6,44,1,-1,0\n", "enabled"),
    "points upside down": ("g.points", "mapX,mapY,sourceX,sourceY,enable\n6,44,9,9,1\n", "sourceY"),
    "points cells": ("g.points", "mapX,mapY,sourceX,sourceY\n6,44,9\n", "line 2: 4 cells"),
    "not json": ("g.geojson", "hello", "vector layer of points expected"),
    "line": (
        "g.geojson",
        '{"type":"Feature","properties":{},"geometry":{"type":"LineString",'
        '"coordinates":[[6,44],[7,45]]}}',
        "a point expected",
    ),
    "ending": ("g.docx", "x", "expected as its ending"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_control_is_refused_in_one_line_that_names_it(tmp_path: Path, case: str) -> None:
    name, text, message = HOSTILE[case]
    path = written(tmp_path / name, text)
    with pytest.raises(GeopositionError, match=message) as caught:
        weighted(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_wrong_system_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "g.csv", CSV)
    with pytest.raises(ProductError, match="unknown coordinate reference system"):
        geodetic(read_control_file(path, "EPSG:nonsense"))


def test_unknown_products_are_named_with_the_known_ones(tmp_path: Path) -> None:
    names = ImageNames(("left", "right"), (Path("a/l.xml"), Path("a/r.xml")))
    path = tmp_path / "t.csv"
    given = np.array(["left", "1", "l.xml", "/data/r.xml", "r"])
    assert names.numbers_of(path, given).tolist() == [0, 1, 0, 1, 1]
    with pytest.raises(ProductError, match="product 'middle': one of these expected: left, right"):
        names.numbers_of(path, np.array(["middle"]))
