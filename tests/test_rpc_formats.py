"""RPC files: every dialect there and back bit for bit, GDAL as a second reader, damaged files."""

from __future__ import annotations

import contextlib
import json
import struct
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rasterio.errors import NotGeoreferencedWarning
from rasterio.rpc import RPC
from rasterio.transform import Affine, RPCTransformer
from test_rpc_model import example, pixels

from geoposition.errors import (
    ArgumentError,
    GeopositionError,
    MissingFileError,
    ProductError,
    UnsupportedError,
)
from geoposition.rpc.direct import DirectRpc
from geoposition.rpc.formats import DIALECTS, read_rpc, verify, write_rpc
from geoposition.rpc.formats._fields import SCALAR_FIELDS, from_one_based, to_one_based
from geoposition.rpc.model import RpcModel, RpcValidity

NAMES = {
    "rpb": "a.RPB", "rpc_txt": "a_RPC.TXT", "dimap": "a_RPC.XML", "dimap_system": "PHRDIMAP_a.XML",
    "maxar_xml": "a.XML", "geotiff": "a.tif", "geom": "a.geom", "json": "a.json",
}  # fmt: skip
TEXTS = [name for name in NAMES if name != "geotiff"]


def full_example() -> RpcModel:
    rng = np.random.default_rng(5)
    return example(
        line_off_px=12000.099999999999, err_bias_m=3.31, err_rand_m=0.1 + 0.2,
        fit_error_px=(0.1 / 3.0, 0.2 / 3.0), satellite="WV02", band="P", image_shape=(2400, 3600),
        direct=DirectRpc(*(rng.normal(size=(4, 20)) + np.eye(1, 20)), fit_error_m=(1e-3, 2e-3)),
        validity=RpcValidity((0.0, 2399.0), (-27.0, 3599.0), (5.15, 5.41), (44.0, 44.2)),
    )  # fmt: skip


def assert_same_geometry(a: RpcModel, b: RpcModel) -> None:
    """Bit for bit."""
    for field in SCALAR_FIELDS.values():
        assert getattr(a, field) == getattr(b, field), field
    for field in ("line_num", "line_den", "samp_num", "samp_den"):
        assert np.array_equal(getattr(a, field), getattr(b, field)), field


def as_gdal(model: RpcModel) -> RPC:
    scalars = {key.lower(): getattr(model, field) for key, field in SCALAR_FIELDS.items()}
    return RPC(
        **scalars, line_num_coeff=model.line_num.tolist(), line_den_coeff=model.line_den.tolist(),
        samp_num_coeff=model.samp_num.tolist(), samp_den_coeff=model.samp_den.tolist(),
    )  # fmt: skip


@pytest.mark.parametrize("dialect", NAMES)
def test_there_and_back_bit_for_bit(dialect: str, tmp_path: Path) -> None:
    model = full_example()
    path = tmp_path / NAMES[dialect]
    write_rpc(model, path, dialect)
    back = read_rpc(path)
    assert_same_geometry(model, back)
    if dialect not in ("dimap", "dimap_system"):
        assert (back.err_bias_m, back.err_rand_m) == (model.err_bias_m, model.err_rand_m)
    if dialect not in ("dimap", "rpb", "rpc_txt"):
        assert back.image_shape == model.image_shape
    if dialect in ("dimap", "dimap_system", "json"):
        assert back.fit_error_px == model.fit_error_px
        assert back.direct is not None
        assert model.direct is not None
        assert back.direct.fit_error_m == model.direct.fit_error_m
        for name in ("lon_num", "lon_den", "lat_num", "lat_den"):
            assert np.array_equal(getattr(back.direct, name), getattr(model.direct, name))
    if dialect in ("dimap", "json"):
        assert back.validity == model.validity
    if dialect in ("rpb", "maxar_xml", "json"):
        assert (back.satellite, back.band) == ("WV02", "P")
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("dialect", NAMES)
def test_what_is_not_known_stays_unknown(dialect: str, tmp_path: Path) -> None:
    model = example(image_shape=(7, 5))
    write_rpc(model, tmp_path / NAMES[dialect], dialect)
    back = read_rpc(tmp_path / NAMES[dialect])
    assert back.err_bias_m is back.err_rand_m is back.direct is back.validity is None


@settings(max_examples=200)
@given(st.floats(-1e6, 1e6))
def test_one_based_text_keeps_every_bit(value: float) -> None:
    assert from_one_based(Path("x"), "LINE_OFF", to_one_based(value)) == value


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    numbers=st.lists(st.floats(1e-300, 1.0, allow_subnormal=False), min_size=19, max_size=19),
    dialect=st.sampled_from(sorted(NAMES)),
)
def test_small_coefficients_keep_every_bit(
    numbers: list[float], dialect: str, tmp_path: Path
) -> None:
    model = example(line_den=np.array([100.0, *numbers]), image_shape=(9, 9))
    path = tmp_path / NAMES[dialect]
    path.unlink(missing_ok=True)
    write_rpc(model, path, dialect)
    assert_same_geometry(model, read_rpc(path))


def test_pixel_origins_and_units_in_the_files(tmp_path: Path) -> None:
    model = example(line_off_px=100.25, samp_off_px=200.5)
    for dialect, expected in {
        "rpb": "lineOffset = 100.25;",
        "rpc_txt": "LINE_OFF: 100.25 pixels",
        "dimap": "<LINE_OFF>101.25</LINE_OFF>",
        "dimap_system": "<B>101.25</B>",
        "maxar_xml": "<LINEOFFSET>100.25</LINEOFFSET>",
        "geom": "line_off:  100.25",
        "json": '"line_off_px": 100.25',
    }.items():
        path = tmp_path / NAMES[dialect]
        write_rpc(model, path, dialect)
        assert expected in path.read_text(), dialect


def test_gdal_projects_to_the_same_pixel() -> None:
    model = example(size=1e-2)
    image, height = pixels(model, 400)
    geodetic = model.image_to_ground(image, height).geodetic
    with RPCTransformer(as_gdal(model)) as gdal:
        line, samp = gdal.rowcol(*np.degrees(geodetic[:, :2]).T, zs=height, op=lambda value: value)
    # GDAL counts from the corner of the first pixel, we from its centre.
    corner_px = np.stack([line, samp], axis=1)
    np.testing.assert_allclose(corner_px - 0.5, image, rtol=0, atol=1e-6)


@pytest.mark.parametrize("sidecar", ["a.RPB", "a_RPC.TXT"])
def test_gdal_reads_our_text_files(sidecar: str, tmp_path: Path) -> None:
    model = full_example()
    blank_image(tmp_path / "a.tif")
    write_rpc(model, tmp_path / sidecar)
    with rasterio.open(tmp_path / "a.tif") as source:
        rpcs = source.rpcs
    for key, field in SCALAR_FIELDS.items():
        assert getattr(rpcs, key.lower()) == getattr(model, field), key
    assert rpcs.samp_den_coeff == model.samp_den.tolist()
    assert_same_geometry(read_rpc(tmp_path / "a.tif"), model)
    assert read_rpc(tmp_path / "a.tif").shape == (5, 7)


def test_gdal_reads_our_tag_and_pixels_stay(tmp_path: Path) -> None:
    model = replace(full_example(), image_shape=(5, 7))
    path = tmp_path / "a.tif"
    pixels_before = blank_image(path)
    write_rpc(model, path)
    with rasterio.open(path) as source:
        assert np.array_equal(source.read(1), pixels_before)
        assert source.rpcs.line_num_coeff == pytest.approx(model.line_num.tolist(), rel=1e-14)
        assert source.rpcs.line_off == pytest.approx(model.line_off_px, rel=1e-14)
    assert_same_geometry(read_rpc(path), model)
    with pytest.raises(ProductError, match="image size"):
        write_rpc(full_example(), path)
    assert_same_geometry(read_rpc(path), model)


@pytest.mark.parametrize("options", [{"BIGTIFF": "YES"}, {"ENDIANNESS": "BIG"}])
def test_tag_is_read_from_every_kind_of_tiff(options: dict[str, str], tmp_path: Path) -> None:
    model = replace(full_example(), image_shape=(5, 7))
    blank_image(tmp_path / "a.tif", **options)
    write_rpc(model, tmp_path / "a.tif")
    assert_same_geometry(read_rpc(tmp_path / "a.tif"), model)


def blank_image(path: Path, transform: Affine | None = None, **options: str) -> np.ndarray:
    values = np.arange(35, dtype=np.uint8).reshape(5, 7)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(
            path, "w", driver="GTiff", width=7, height=5, count=1, dtype="uint8",
            transform=transform, **options,
        ) as target:  # fmt: skip
            target.write(values, 1)
    return values


def test_a_crop_with_the_whole_images_rpc_gets_its_own_pixels(tmp_path: Path) -> None:
    blank_image(tmp_path / "a.tif", Affine.translation(4000, 3000))
    write_rpc(example(), tmp_path / "a.geom")
    crop = read_rpc(tmp_path / "a.tif")
    assert crop.shape == (5, 7)
    assert (crop.line_off_px, crop.samp_off_px) == (11999.5 - 3000, 17999.5 - 4000)
    assert read_rpc(tmp_path / "a.geom").shape == (24000, 36000)


def test_layouts_of_rpb_may_vary(tmp_path: Path) -> None:
    model = full_example()
    write_rpc(model, tmp_path / "a.RPB")
    text = (tmp_path / "a.RPB").read_text()
    loose = text.replace(";", "").replace("\t", "  ").replace("= (\n", "=(").replace('"', "")
    (tmp_path / "b.RPB").write_bytes(loose.replace("\n", "\r\n").encode())
    assert_same_geometry(read_rpc(tmp_path / "b.RPB"), model)
    upper = text.upper().replace(",\n", ",")
    (tmp_path / "c.rpb").write_text(upper)
    assert_same_geometry(read_rpc(tmp_path / "c.rpb"), model)


def test_layouts_of_rpc_txt_may_vary(tmp_path: Path) -> None:
    model = example()
    write_rpc(model, tmp_path / "a_RPC.TXT")
    text = (tmp_path / "a_RPC.TXT").read_text()
    plain = (
        text.replace(" pixels", "").replace(" meters", "").replace(": ", ":\t+").replace("+-", "-")
    )
    (tmp_path / "content_not_name.dat").write_bytes(b"\xef\xbb\xbf" + plain.encode())
    assert_same_geometry(read_rpc(tmp_path / "content_not_name.dat"), model)


def damaged(text: str, dialect: str, kind: str) -> tuple[str, str]:
    """Damage `text`; return it with what the message must name."""
    keys = {
        "rpb": ("latOffset", "lineScale", "lineDenCoef"),
        "rpc_txt": ("LAT_OFF", "LINE_SCALE", "LINE_DEN_COEFF"),
        "dimap": ("LAT_OFF", "LINE_SCALE", "LINE_DEN_COEFF"),
        "dimap_system": ("Lat", "Row", "F_ROW"),
        "maxar_xml": ("LATOFFSET", "LINESCALE", "LINEDENCOEF"),
        "geom": ("lat_off", "line_scale", "line_den_coeff"),
        "json": ("lat_off_deg", "line_scale_px", "line_den"),
    }[dialect]
    off, scale, coefficients = keys
    model = example()
    lat, line = repr(model.lat_off_deg), repr(model.line_scale_px)
    last = repr(model.line_den.tolist()[-1])
    before, found, after = text.partition(off)
    assert found
    if kind == "key missing":
        rest = after.partition(off) if dialect in ("dimap", "maxar_xml", "dimap_system") else None
        if rest is None:
            return before + "gone" + after, off
        return before + "gone" + rest[0] + "gone" + rest[2], off
    if kind == "not a number":
        word = '"north"' if dialect == "json" else "north"
        return before + off + after.replace(lat, word, 1), off
    if kind == "nan":
        return before + off + after.replace(lat, "NaN", 1), off
    if kind == "zero scale":
        begin, name, rest_of = text.partition(scale)
        return begin + name + rest_of.replace(line, "0.0", 1), scale
    if kind == "19 coefficients":
        assert last in text
        if dialect in ("rpc_txt", "dimap", "geom"):
            number = {"rpc_txt": "_20", "dimap": "_20", "geom": "_19"}[dialect]
            name = coefficients + number
            assert name in text
            return text.replace(name, "gone"), name
        if dialect == "rpb":
            return text.replace(f",\n\t\t\t{last});", ");", 1), coefficients
        if dialect == "json":
            return text.replace(f",\n  {last}\n", "\n", 1), coefficients
        return text.replace(f" {last}", "", 1), coefficients
    raise AssertionError(kind)


@pytest.mark.parametrize("dialect", TEXTS)
@pytest.mark.parametrize(
    "kind", ["key missing", "not a number", "nan", "zero scale", "19 coefficients"]
)
def test_damage_is_named_in_one_line(dialect: str, kind: str, tmp_path: Path) -> None:
    path = tmp_path / NAMES[dialect]
    write_rpc(example(), path, dialect)
    text, named = damaged(path.read_text(), dialect, kind)
    assert text != path.read_text()
    path.write_text(text)
    with pytest.raises(ProductError) as caught:
        read_rpc(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert named in message
    assert "\n" not in message


@pytest.mark.parametrize("dialect", TEXTS)
def test_a_key_given_twice_is_refused(dialect: str, tmp_path: Path) -> None:
    path = tmp_path / NAMES[dialect]
    write_rpc(example(), path, dialect)
    lines = path.read_text().splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if "44.13" in line)
    path.write_text("".join([*lines[: at + 1], lines[at], *lines[at + 1 :]]))
    with pytest.raises(ProductError, match="twice"):
        read_rpc(path)


@pytest.mark.parametrize("dialect", NAMES)
def test_every_cut_is_refused_or_harmless(dialect: str, tmp_path: Path) -> None:
    whole = tmp_path / NAMES[dialect]
    model = example(image_shape=(9, 9))
    write_rpc(model, whole, dialect)
    data = whole.read_bytes()
    path = tmp_path / f"cut{whole.suffix}"
    for share in np.linspace(0.0, 0.97, 41):
        path.write_bytes(data[: int(share * len(data))])
        try:
            back = read_rpc(path)
        except ProductError:
            continue
        assert_same_geometry(back, model)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "empty"),
        (b"\x00\x01\x02\xff" * 400, "binary"),
        (bytes(range(1, 256)) * 4, "no known dialect"),
        (b"once upon a time\n", "no known dialect"),
        (b"<?xml version='1.0'?><Level-1C_User_Product/>", "Level-1C_User_Product"),
        (b"<Dimap_Document><Dataset/></Dimap_Document>", "Rational_Function_Model"),
        (b"<isd><IMD/></isd>", "RPB"),
        (b"<isd><RPB>", "line 1"),
        (b'<!DOCTYPE x [<!ENTITY a "b"><!ENTITY c "&a;&a;">]><isd>&c;</isd>', "entities"),
        (b"{}", "format"),
        (b"[1, 2]", "no known dialect"),
        (b'{"format": "geoposition-rpc", "version": 2}', "version"),
        (b'{"format": ', "line 1"),
        (b"II*\x00\xff\xff\xff\xff", "image"),
        (b"II*\x00\x08\x00\x00\x00\x00\x00", "image"),
    ],
)
def test_what_is_no_rpc_is_refused(content: bytes, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(ProductError) as caught:
        read_rpc(path)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError):
        read_rpc(tmp_path / "none.RPB")
    with pytest.raises(ProductError, match="folder"):
        read_rpc(tmp_path)
    with pytest.raises(MissingFileError):
        write_rpc(example(), tmp_path / "none" / "a.RPB")
    with pytest.raises(UnsupportedError, match="name"):
        write_rpc(example(), tmp_path / "a.doc")
    with pytest.raises(ArgumentError, match="dialect"):
        write_rpc(example(), tmp_path / "a.RPB", "vrt")
    (tmp_path / "a.json").mkdir()
    with pytest.raises(ProductError, match="folder"):
        write_rpc(example(), tmp_path / "a.json")
    (tmp_path / "b.tif").write_text("no image")
    with pytest.raises(ProductError, match="TIFF"):
        write_rpc(example(), tmp_path / "b.tif")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.json", "b.tif"]


def test_images_without_rpc_are_refused(tmp_path: Path) -> None:
    blank_image(tmp_path / "a.tif")
    with pytest.raises(ProductError, match="no tag"):
        read_rpc(tmp_path / "a.tif")


def test_a_false_tag_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    write_rpc(example(image_shape=(9, 9)), path)
    data = bytearray(path.read_bytes())
    entry = data.index(struct.pack("<HHI", 50844, 12, 92))
    (where,) = struct.unpack_from("<I", data, entry + 8)
    struct.pack_into("<d", data, where + 8 * 7, 0.0)  # LINE_SCALE
    path.write_bytes(data)
    with pytest.raises(ProductError, match="LINE_SCALE"):
        read_rpc(path)
    struct.pack_into("<d", data, where + 8 * 7, float("nan"))
    path.write_bytes(data)
    with pytest.raises(ProductError, match="LINE_SCALE"):
        read_rpc(path)


def test_other_coefficient_orders_and_adjusted_models_are_unsupported(tmp_path: Path) -> None:
    for dialect, old, new, named in [
        ("rpb", "RPC00B", "RPC00A", "SpecId"),
        ("maxar_xml", "RPC00B", "RPC00A", "SPECID"),
        ("geom", "polynomial_format:  B", "polynomial_format:  A", "polynomial_format"),
        ("geom", "type:", "adjustment_0.adj_param_0.parameter: 0.5\ntype:", "adj_param_0"),
    ]:
        path = tmp_path / NAMES[dialect]
        write_rpc(example(), path, dialect)
        path.write_text(path.read_text().replace(old, new))
        with pytest.raises(UnsupportedError, match=named):
            read_rpc(path)


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.json"
    write_rpc(example(), path)
    before = path.read_bytes()

    def fail(self: Path, *args: object, **kwargs: object) -> None:
        self.write_bytes(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(OSError, match="disk full"):
        write_rpc(example(), path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), dialect=st.sampled_from(TEXTS))
def test_random_damage_never_escapes_the_error_family(
    data: st.DataObject, dialect: str, tmp_path: Path
) -> None:
    path = tmp_path / NAMES[dialect]
    write_rpc(example(), path, dialect)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    with contextlib.suppress(GeopositionError):
        assert isinstance(read_rpc(path), RpcModel)


def test_every_dialect_has_reader_and_writer() -> None:
    assert set(DIALECTS) == set(NAMES)


def test_json_names_its_fields(tmp_path: Path) -> None:
    write_rpc(full_example(), tmp_path / "a.json")
    document = json.loads((tmp_path / "a.json").read_text())
    assert document["format"] == "geoposition-rpc"
    assert document["image_shape"] == [2400, 3600]
    document["line_num"] = document["line_num"][:-1]
    (tmp_path / "a.json").write_text(json.dumps(document))
    with pytest.raises(ProductError, match="line_num"):
        read_rpc(tmp_path / "a.json")


@pytest.mark.parametrize("name", ["a.RPB", "a_RPC.TXT", "a.XML", "a.geom", "a.json", "a.tif"])
def test_each_dialect_states_pixel_origin_and_height_datum(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    write_rpc(example(), path)
    if name.endswith(".tif"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as source:
                text = " ".join(source.tags().values())
    else:
        text = path.read_text(encoding="utf-8")
    first = "(1, 1)" if name.endswith(".XML") else "(0, 0)"
    assert f"the centre of the first pixel is {first}" in text
    assert "metres above the WGS 84 ellipsoid" in text


@pytest.mark.parametrize("name", ["a.RPB", "a.tif"])
def test_a_file_that_fails_its_verification_is_not_written(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verify, "TOLERANCE_PX", -1.0)
    with pytest.raises(ProductError, match="not written"):
        verify.write_verified(example(), tmp_path / name)
    assert list(tmp_path.iterdir()) == []
