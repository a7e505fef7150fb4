"""DigitalGlobe support data: both forms, the physics of the model, hostile input.

The product here is synthetic: a circular path over the equator, camera to the nadir. Tests on
real products are in `real/test_digitalglobe.py`, which uses `as_text_set` of this file.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geoposition.constants import EARTH_RATE_RAD_S, SPEED_OF_LIGHT_M_S, WGS84_A_M
from geoposition.corrections import ALL_CORRECTIONS
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import MissingFileError, ProductError, UnsupportedError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.model import RpcModel
from geoposition.sensors.readers import digitalglobe
from geoposition.sensors.readers.digitalglobe_model import body_covariance_rad2
from geoposition.sensors.readers.source import Source
from geoposition.timescale import Epoch

LINES, SAMPLES = 2001, 1001
ALTITUDE_M = 700e3
RATE_HZ = 5000.0
PITCH_MM, DISTANCE_MM = 0.008, 8000.0
STEM = "20JAN01000000-P1BS-000000000010_01_P001"

# The documentation's spelling of the keys, which the XML has in capitals.
_KEYS = """
version generationTime productOrderId productCatalogId childCatalogId imageDescriptor bandId
panSharpenAlgorithm numRows numColumns productLevel productType numberOfLooks radiometricLevel
bitsPerPixel compressionType jpegProfileName outputFormat ULLon ULLat ULHAE URLon URLat URHAE
LRLon LRLat LRHAE LLLon LLLat LLHAE absCalFactor effectiveBandwidth TDILevel satId mode
scanDirection catId TLCTime numTLC TLCList firstLineTime avgLineRate exposureDuration
minCollectedRowGSD maxCollectedRowGSD meanCollectedRowGSD minCollectedColGSD maxCollectedColGSD
meanCollectedColGSD meanCollectedGSD meanProductRowGSD meanProductColGSD meanProductGSD
rowUncertainty colUncertainty minSunAz maxSunAz meanSunAz minSunEl maxSunEl meanSunEl minSatAz
maxSatAz meanSatAz minSatEl maxSatEl meanSatEl minInTrackViewAngle maxInTrackViewAngle
meanInTrackViewAngle minCrossTrackViewAngle maxCrossTrackViewAngle meanCrossTrackViewAngle
minOffNadirViewAngle maxOffNadirViewAngle meanOffNadirViewAngle PNIIRS cloudCover
resamplingKernel positionKnowledgeSrc attitudeKnowledgeSrc revNumber stripId type startTime
numPoints timeInterval ephemList attList numTiles tileSizeX tileSizeY tileUnits tileOverlap
filename ULColOffset ULRowOffset URColOffset URRowOffset LRColOffset LRRowOffset LLColOffset
LLRowOffset effectiveTime modelGenerationTime geoModelLevel PD polyOrder aList bList cX cY cZ
qcs1 qcs2 qcs3 qcs4 detArrId detOriginX detOriginY detRotAngle detPitch specId errBias errRand
lineOffset sampOffset latOffset longOffset heightOffset lineScale sampScale latScale longScale
heightScale lineNumCoef lineDenCoef sampNumCoef sampDenCoef
"""
SPELLING = {name.upper(): name for name in _KEYS.split()}
_NUMBERED = {"IMAGE", "TILE", "DETECTOR_ARRAY", "STEREO_PAIR"}
_FLAT_LISTS = {"LINENUMCOEF", "LINEDENCOEF", "SAMPNUMCOEF", "SAMPDENCOEF", "ALIST", "BLIST"}


def as_text_set(isd: ET.Element, folder: Path, stem: str = STEM) -> Path:
    """Write an `isd` as the set of text files; return the .IMD."""
    for part in isd:
        lines = _text_lines(part, part.tag, "")
        if part.tag == "TIL":
            lines = ["BEGIN_GROUP = TILESET", *lines, "END_GROUP = TILESET"]
        (folder / f"{stem}.{part.tag}").write_text("\n".join([*lines, "END;", ""]))
    return folder / f"{stem}.IMD"


def _text_lines(group: ET.Element, part: str, indent: str) -> list[str]:
    lines, counts = [], dict.fromkeys(_NUMBERED, 0)
    for child in group:
        if child.tag.endswith("List"):
            name = SPELLING[child.tag[:-4].upper()]
            rows = [", ".join((row.text or "").split()) for row in child]
            if name.upper() not in _FLAT_LISTS:
                rows = [f"({row})" for row in rows]
            lines += [f"{indent}{name} = (", ",\n".join(f"{indent}{row}" for row in rows) + "\t);"]
        elif len(child) or child.tag not in SPELLING:
            name = child.tag
            if name in _NUMBERED and part != "RPB":
                counts[name] += 1
                name = f"{name}_{counts[name]}"
            lines += [f"{indent}BEGIN_GROUP = {name}"]
            lines += _text_lines(child, part, indent + "\t")
            lines += [f"{indent}END_GROUP = {name}"]
        else:
            text = child.text or ""
            quoted = text[:1].isalpha() or child.tag == "FILENAME"
            lines.append(
                f"{indent}{SPELLING[child.tag]} = " + (f'"{text}";' if quoted else f"{text};")
            )
    return lines


def _grow(parent: ET.Element, tree: dict[str, object]) -> ET.Element:
    for tag, value in tree.items():
        if isinstance(value, list) and tag.endswith("List"):
            table = ET.SubElement(parent, tag)
            for row in value:
                text = " ".join(repr(float(v)) for v in row)
                ET.SubElement(table, tag[:-4]).text = text
        elif isinstance(value, list):
            for item in value:
                _grow(ET.SubElement(parent, tag), item)
        elif isinstance(value, dict):
            _grow(ET.SubElement(parent, tag), value)
        else:
            ET.SubElement(parent, tag).text = str(value)
    return parent


def orbit(times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and quaternion body to ECEF; southwards over (0, 0) at 1 s."""
    radius, rate = WGS84_A_M + ALTITUDE_M, 1.05e-3
    angle = -rate * (times_s - 1.0)
    zero = np.zeros_like(angle)
    up = np.stack([np.cos(angle), zero, np.sin(angle)], axis=-1)
    ahead = np.stack([np.sin(angle), zero, -np.cos(angle)], axis=-1)
    R = np.stack([ahead, np.cross(-up, ahead), -up], axis=-1)
    return radius * up, radius * rate * ahead, Rotation.from_matrix(R).as_quat()


def make_isd(**changes: object) -> ET.Element:
    """Product with its line (LINES − 1) / 2 at (0, 0), 1 s after 2020-01-01."""
    times = np.arange(101) * 0.02
    position, velocity, quat = orbit(times)
    index = np.arange(1, 102)[:, None]
    covariance = np.tile([1e-4, 0, 0, 1e-4, 0, 1e-4], (101, 1))
    q_covariance = np.tile([1e-12, 0, 0, 0, 1e-12, 0, 0, 1e-12, 0, 1e-12], (101, 1))
    half = (LINES - 1) / 2 / RATE_HZ
    series = {"SATID": "WV02", "STARTTIME": "2020-01-01T00:00:00.000000Z", "NUMPOINTS": 101}
    series["TIMEINTERVAL"] = 0.02
    first = f"2020-01-01T00:00:{1 - half:09.6f}Z"
    rpc = {"LINEOFFSET": 1000, "SAMPOFFSET": 500, "LATOFFSET": 0, "LONGOFFSET": 0}
    rpc |= {"HEIGHTOFFSET": 300, "LINESCALE": 1000, "SAMPSCALE": 500, "LATSCALE": 0.01}
    rpc |= {"LONGSCALE": 0.003, "HEIGHTSCALE": 500}
    unit = np.eye(20)
    isd = _grow(
        ET.Element("isd"),
        {
            "IMD": {
                "GENERATIONTIME": "2020-01-02T00:00:00.000000Z",
                "IMAGEDESCRIPTOR": "Basic1B",
                "BANDID": "P",
                "NUMROWS": LINES,
                "NUMCOLUMNS": SAMPLES,
                "PRODUCTLEVEL": "LV1B",
                "BAND_P": {
                    f"{corner}{what}": value
                    for corner in ("UL", "UR", "LR", "LL")
                    for what, value in (("LON", 1.5), ("LAT", -2.5), ("HAE", 100.0))
                },
                "IMAGE": {
                    "SATID": "WV02",
                    "SCANDIRECTION": "Forward",
                    "CATID": "103001000000AA00",
                    "TLCTIME": first,
                    "NUMTLC": 2,
                    "TLCLISTList": [[0, 0], [2 * LINES, 2 * LINES / RATE_HZ]],
                    "FIRSTLINETIME": first,
                    "AVGLINERATE": RATE_HZ,
                    "MEANPRODUCTGSD": 0.7,
                },
            },
            "EPH": {
                **series,
                "EPHEMLISTList": list(np.hstack([index, position, velocity, covariance])),
            },
            "ATT": {**series, "ATTLISTList": list(np.hstack([index, quat, q_covariance]))},
            "TIL": {
                "BANDID": "P",
                "NUMTILES": 1,
                "TILE": {
                    "FILENAME": "IMAGE.TIF",
                    "ULCOLOFFSET": 0,
                    "ULROWOFFSET": 0,
                    "LRCOLOFFSET": SAMPLES - 1,
                    "LRROWOFFSET": LINES - 1,
                },
            },
            "GEO": {
                "SATID": "WV02",
                "GEOMODELLEVEL": "LV1B",
                "PRINCIPAL_DISTANCE": {"PD": DISTANCE_MM},
                "OPTICAL_DISTORTION": {"POLYORDER": -1, "ALISTList": [], "BLISTList": []},
                "PERSPECTIVE_CENTER": {"CX": 0.0, "CY": 0.0, "CZ": 0.0},
                "CAMERA_ATTITUDE": {"QCS1": 0.0, "QCS2": 0.0, "QCS3": 0.0, "QCS4": 1.0},
                "DETECTOR_MOUNTING": {
                    "BAND_P": {
                        "BANDID": "P",
                        "DETECTOR_ARRAY": {
                            "DETARRID": 1,
                            "DETORIGINX": 0.0,
                            "DETORIGINY": (SAMPLES - 1) / 2 * PITCH_MM,
                            "DETROTANGLE": 0.0,
                            "DETPITCH": PITCH_MM,
                        },
                    }
                },
            },
            "RPB": {
                "SATID": "WV02",
                "BANDID": "P",
                "SPECID": "RPC00B",
                "IMAGE": {
                    "ERRBIAS": 5.0,
                    "ERRRAND": 0.2,
                    **rpc,
                    "LINENUMCOEFList": [-unit[2]],
                    "LINEDENCOEFList": [unit[0]],
                    "SAMPNUMCOEFList": [unit[1]],
                    "SAMPDENCOEFList": [unit[0]],
                },
            },
        },
    )
    for path, value in changes.items():
        find(isd, path.replace("__", "/")).text = str(value)
    return isd


def find(isd: ET.Element, path: str) -> ET.Element:
    element = isd.find(path)
    assert element is not None, path
    return element


def drop(isd: ET.Element, path: str) -> ET.Element:
    parent = isd.find(path.rpartition("/")[0] or ".")
    assert parent is not None
    parent.remove(find(isd, path))
    return isd


def source_of(path: Path) -> Source:
    return Source.of(path)


def read_isd(isd: ET.Element, folder: Path, form: str = "xml") -> Product:
    if form == "text":
        return digitalglobe.read(source_of(as_text_set(isd, folder)))
    path = folder / f"{STEM}.XML"
    path.write_bytes(ET.tostring(isd))
    return digitalglobe.read(source_of(path))


forms = pytest.mark.parametrize("form", ["xml", "text"])
GRID = np.stack(
    np.meshgrid(np.linspace(0, LINES - 1, 9), np.linspace(0, SAMPLES - 1, 7), indexing="ij"), -1
)


# The model -----------------------------------------------------------------------------------


@forms
def test_nadir_pixel_in_closed_form(tmp_path: Path, form: str) -> None:
    product = read_isd(make_isd(), tmp_path, form)
    model = product.model
    assert isinstance(model, PushbroomModel)
    assert model.shape == (LINES, SAMPLES)
    assert model.corrections == ALL_CORRECTIONS
    ground = model.image_to_ground([(LINES - 1) / 2, (SAMPLES - 1) / 2], 0.0).geodetic
    north_m, east_m = WGS84_A_M * (1 - 0.00669438) * ground[1], WGS84_A_M * ground[0]
    speed = (WGS84_A_M + ALTITUDE_M) * 1.05e-3
    # Light comes from behind the nadir: aberration by v / c, and the ground's own motion.
    assert north_m == pytest.approx(ALTITUDE_M * speed / SPEED_OF_LIGHT_M_S, abs=2e-3)
    drift_m = -ALTITUDE_M * EARTH_RATE_RAD_S * ALTITUDE_M / SPEED_OF_LIGHT_M_S
    assert east_m == pytest.approx(drift_m, abs=2e-3)


def test_samples_run_against_body_y_and_lines_along_the_path(tmp_path: Path) -> None:
    model = read_isd(make_isd(), tmp_path).model
    line, sample = (LINES - 1) / 2, (SAMPLES - 1) / 2
    image = [[line, sample], [line, sample + 100], [line + 100, sample]]
    here = model.image_to_ground(image, 0.0).geodetic
    ecef = geodetic_to_ecef(here)
    # Flying south, body y is west: samples run east, one pitch each, and lines south.
    # Refraction shortens the step by (n0 - 1) H / altitude, 3.3e-6.
    step_m = 100 * PITCH_MM / DISTANCE_MM * ALTITUDE_M
    assert (ecef[1] - ecef[0])[1] == pytest.approx(step_m * (1 - 3.3e-6), rel=1e-6)
    speed_m_s = WGS84_A_M * 1.05e-3
    assert (ecef[2] - ecef[0])[2] == pytest.approx(-100 / RATE_HZ * speed_m_s, rel=5e-3)


def test_both_forms_give_the_same_model(tmp_path: Path) -> None:
    xml, text = (read_isd(make_isd(), tmp_path, form) for form in ("xml", "text"))
    a, b = (p.model.image_to_ground(GRID, 200.0).geodetic for p in (xml, text))
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-14)
    assert xml.details == text.details
    assert xml.start == text.start == Epoch.from_utc("2020-01-01T00:00:00.8Z")
    assert xml.vendor_rpc is not None
    assert text.vendor_rpc is not None
    np.testing.assert_array_equal(xml.vendor_rpc.line_num, text.vendor_rpc.line_num)


def test_reverse_scan_mirrors_the_lines(tmp_path: Path) -> None:
    forward = read_isd(make_isd(), tmp_path).model
    isd = make_isd(IMD__IMAGE__SCANDIRECTION="Reverse")
    last = "2020-01-01T00:00:01.200000Z"
    find(isd, "IMD/IMAGE/TLCTIME").text = find(isd, "IMD/IMAGE/FIRSTLINETIME").text = last
    rows = find(isd, "IMD/IMAGE/TLCLISTList")
    rows[1].text = f"{2 * LINES} {-2 * LINES / RATE_HZ!r}"
    product = read_isd(isd, tmp_path)
    assert "notes" not in product.details
    mirrored = [LINES - 1, 0] + GRID * [-1, 1]
    a = forward.image_to_ground(GRID, 0.0).geodetic
    b = product.model.image_to_ground(mirrored, 0.0).geodetic
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-11)


@pytest.mark.parametrize("direction", ["Forward", "Reverse"])
def test_single_line_time_goes_on_with_the_mean_rate(tmp_path: Path, direction: str) -> None:
    isd = make_isd(IMD__IMAGE__NUMTLC=1, IMD__IMAGE__SCANDIRECTION=direction)
    start = "2020-01-01T00:00:01.000000Z"
    find(isd, "IMD/IMAGE/TLCTIME").text = find(isd, "IMD/IMAGE/FIRSTLINETIME").text = start
    rows = find(isd, "IMD/IMAGE/TLCLISTList")
    rows.remove(rows[1])
    product = read_isd(isd, tmp_path)
    model = product.model
    assert isinstance(model, PushbroomModel)
    sign = 1 if direction == "Forward" else -1
    assert model.camera.timing.time_s(500.0) == pytest.approx(sign * 500 / RATE_HZ, abs=1e-12)
    assert "AVGLINERATE" in str(product.details["notes"])


def test_mounting_and_perspective_centre(tmp_path: Path) -> None:
    turn = Rotation.from_rotvec([0.02, -0.01, 0.3])
    isd = make_isd()
    for i, value in enumerate(turn.as_quat(), start=1):
        find(isd, f"GEO/CAMERA_ATTITUDE/QCS{i}").text = repr(float(value))
    for axis, value in zip("XYZ", (1.0, -2.0, 3.0), strict=True):
        find(isd, f"GEO/PERSPECTIVE_CENTER/C{axis}").text = str(value)
    product = read_isd(isd, tmp_path)
    assert "metres" in str(product.details["notes"])
    middle = [(LINES - 1) / 2, (SAMPLES - 1) / 2]
    ray = product.model.rays(middle, 0.0)
    position, _, quat = orbit(np.array([1.0]))
    R_ecef_body = Rotation.from_quat(quat[0])
    expected = position[0] + R_ecef_body.apply([1.0, -2.0, 3.0])
    np.testing.assert_allclose(ray.origin_ecef_m, expected, atol=1e-4)
    apparent = (R_ecef_body * turn).apply([0.0, 0.0, 1.0])
    # What remains is aberration (25 µrad) and refraction.
    assert np.linalg.norm(ray.direction_ecef - apparent) < 3e-5


def test_detector_rotation_and_origin(tmp_path: Path) -> None:
    isd = make_isd()
    array = "GEO/DETECTOR_MOUNTING/BAND_P/DETECTOR_ARRAY"
    find(isd, f"{array}/DETROTANGLE").text = "0.1"
    find(isd, f"{array}/DETORIGINX").text = "2.5"
    model = read_isd(isd, tmp_path).model
    assert isinstance(model, PushbroomModel)
    step = 300 * PITCH_MM
    expected = [2.5 + np.sin(0.1) * step, (SAMPLES - 1) / 2 * PITCH_MM - np.cos(0.1) * step]
    np.testing.assert_allclose(
        model.camera.tangents(0, 300.0), np.array(expected) / DISTANCE_MM, atol=1e-15
    )


def test_body_covariance_against_scattered_quaternions() -> None:
    rng = np.random.default_rng(7)
    true = np.array([[4.0, 1.0, 0.5], [1.0, 2.0, -0.3], [0.5, -0.3, 9.0]]) * 1e-10
    q = Rotation.from_rotvec([0.7, -1.1, 2.0])
    turns = rng.multivariate_normal(np.zeros(3), true, 200_000)
    scattered = (q * Rotation.from_rotvec(turns)).as_quat()
    scattered *= np.sign(scattered @ q.as_quat())[:, None]
    C_q = np.cov(scattered.T)
    found = body_covariance_rad2(q.as_quat()[None], C_q[np.triu_indices(4)][None])[0]
    np.testing.assert_allclose(found, np.cov(turns.T), rtol=1e-3, atol=1e-14)
    np.testing.assert_allclose(found, true, rtol=0, atol=0.02 * true.max())


def test_attitude_carries_the_covariance(tmp_path: Path) -> None:
    product = read_isd(make_isd(), tmp_path)
    assert isinstance(product.model, PushbroomModel)
    attitude = product.model.attitude
    assert attitude.covariance_rad2 is not None
    assert attitude.covariance_rad2.shape == (101, 3, 3)
    expected = np.tile(4e-12 * np.eye(3), (101, 1, 1))
    np.testing.assert_allclose(attitude.covariance_rad2, expected, atol=1e-20)
    sigma = product.details["attitude_sigma_body_arcsec"]
    np.testing.assert_allclose(sigma, [0.4125] * 3, atol=1e-4)
    assert product.details["position_sigma_ecef_m"] == [0.01, 0.01, 0.01]


# What the reader says ------------------------------------------------------------------------


@forms
def test_product_facts(tmp_path: Path, form: str) -> None:
    (tmp_path / "IMAGE.TIF").touch()
    product = read_isd(make_isd(), tmp_path, form)
    assert product.sensor == "WorldView-2"
    assert product.format == digitalglobe.FORMAT
    assert product.image_path == tmp_path / "IMAGE.TIF"
    assert product.is_rigorous
    assert product.model.height_range_m == (-200.0, 800.0)
    assert product.details["catalogue_id"] == "103001000000AA00"
    assert product.details["corners_deg_m"]["UL"] == [1.5, -2.5, 100.0]  # type: ignore[index]
    assert product.vendor_rpc is not None
    assert product.vendor_rpc.shape == (LINES, SAMPLES)


def test_heights_without_rpc(tmp_path: Path) -> None:
    product = read_isd(drop(make_isd(), "RPB"), tmp_path)
    assert product.vendor_rpc is None
    assert product.model.height_range_m == (-400.0, 600.0)


def test_image_of_the_same_stem(tmp_path: Path) -> None:
    (tmp_path / f"{STEM}.NTF").touch()
    assert read_isd(drop(make_isd(), "TIL"), tmp_path).image_path == tmp_path / f"{STEM}.NTF"


def test_file_names_stay_in_the_folder(tmp_path: Path) -> None:
    folder = tmp_path / "product"
    folder.mkdir()
    (tmp_path / "IMAGE.TIF").touch()
    product = read_isd(make_isd(TIL__TILE__FILENAME="../IMAGE.TIF"), folder)
    assert product.image_path is None


@forms
def test_tiles_keep_whole_image_coordinates(tmp_path: Path, form: str) -> None:
    isd = make_isd(TIL__TILE__LRROWOFFSET=999, TIL__NUMTILES=2)
    second = ET.SubElement(find(isd, "TIL"), "TILE")
    for tag, value in (("FILENAME", "B.TIF"), ("ULCOLOFFSET", 0), ("ULROWOFFSET", 1000)):
        ET.SubElement(second, tag).text = str(value)
    for tag, value in (("LRCOLOFFSET", SAMPLES - 1), ("LRROWOFFSET", LINES - 1)):
        ET.SubElement(second, tag).text = str(value)
    product = read_isd(isd, tmp_path, form)
    assert product.image_path is None
    assert product.model.shape == (LINES, SAMPLES)
    assert product.details["tiles_first_last_line_sample"] == {
        "IMAGE.TIF": [0, 0, 999, SAMPLES - 1],
        "B.TIF": [1000, 0, LINES - 1, SAMPLES - 1],
    }


def test_multispectral_uses_its_first_band(tmp_path: Path) -> None:
    isd = make_isd(IMD__BANDID="Multi")
    mounting = find(isd, "GEO/DETECTOR_MOUNTING")
    mounting[0].tag = "BAND_C"
    second = ET.fromstring(ET.tostring(mounting[0]).replace(b"BAND_C", b"BAND_B"))
    find(second, "DETECTOR_ARRAY/DETORIGINX").text = "9.0"
    mounting.append(second)
    product = read_isd(isd, tmp_path)
    assert isinstance(product.model, PushbroomModel)
    assert product.model.camera.tangents(0, 0.0)[0] == 0.0
    assert "BAND_C, BAND_B" in str(product.details["notes"])


@forms
@pytest.mark.parametrize("level", ["LV2A", "Stereo OR2A", "LV3D"])
def test_ortho_ready_falls_back_to_its_rpc(tmp_path: Path, form: str, level: str) -> None:
    product = read_isd(make_isd(IMD__PRODUCTLEVEL=level), tmp_path, form)
    assert isinstance(product.model, RpcModel)
    assert not product.is_rigorous
    assert level in str(product.details["notes"])


@forms
def test_basic_product_delivered_without_camera_gives_its_rpc(tmp_path: Path, form: str) -> None:
    isd = make_isd()
    for part in ("EPH", "ATT", "GEO"):
        drop(isd, part)
    product = read_isd(isd, tmp_path, form)
    assert isinstance(product.model, RpcModel)
    drop(isd, "RPB")
    (tmp_path / f"{STEM}.RPB").unlink(missing_ok=True)
    with pytest.raises(UnsupportedError, match=r"(?i)productLevel"):
        read_isd(isd, tmp_path, form)


def test_distortion_without_coefficients_is_none(tmp_path: Path) -> None:
    isd = make_isd(GEO__OPTICAL_DISTORTION__POLYORDER=2)
    for name in ("ALIST", "BLIST"):
        rows = find(isd, f"GEO/OPTICAL_DISTORTION/{name}List")
        ET.SubElement(rows, name).text = "0.0 0.0 0.0"
    assert read_isd(isd, tmp_path).is_rigorous
    find(isd, "GEO/OPTICAL_DISTORTION/BLISTList")[0].text = "0.0 1e-9 0.0"
    for form in ("xml", "text"):
        with pytest.raises(UnsupportedError, match=r"(?i)polyOrder.*distortion"):
            read_isd(isd, tmp_path, form)


def test_contradicting_line_times_are_noted(tmp_path: Path) -> None:
    isd = make_isd(IMD__IMAGE__FIRSTLINETIME="2020-01-01T00:00:00.900000Z")
    notes = str(read_isd(isd, tmp_path).details["notes"])
    assert "-0.100000 s" in notes
    notes = str(read_isd(make_isd(IMD__IMAGE__SCANDIRECTION="Reverse"), tmp_path).details["notes"])
    assert "contradicts" in notes


# Recognition and the text form ---------------------------------------------------------------


def test_recognition_is_by_content(tmp_path: Path) -> None:
    imd = as_text_set(make_isd(), tmp_path)
    for suffix in ("IMD", "EPH", "ATT", "GEO", "TIL"):
        path = imd.with_suffix(f".{suffix}")
        assert digitalglobe.recognises(source_of(path)), suffix
        assert digitalglobe.read(source_of(path)).path == imd
    assert not digitalglobe.recognises(source_of(imd.with_suffix(".RPB")))
    assert digitalglobe.recognises(Source(imd, b"<isd>", "isd"))
    assert not digitalglobe.recognises(Source(imd, b"<Dimap_Document>", "Dimap_Document"))
    assert not digitalglobe.recognises(Source(imd, b"LINE_OFF: +2.0\n", None))


def test_text_form_in_other_dress(tmp_path: Path) -> None:
    imd = as_text_set(make_isd(), tmp_path)
    expected = digitalglobe.read(source_of(imd)).model.image_to_ground(GRID, 0.0).geodetic
    for path in list(tmp_path.iterdir()):
        text = path.read_text().replace(" = ", "=").replace(", ", ",").replace("\n", "\r\n")
        path.unlink()
        dressed = b"\xef\xbb\xbf" + text.strip().encode()
        path.with_suffix(path.suffix.lower() if path.suffix != ".RPB" else ".RPB").write_bytes(
            dressed if path.suffix != ".RPB" else text.encode()
        )
    product = digitalglobe.read(source_of(imd.with_suffix(".imd")))
    np.testing.assert_array_equal(product.model.image_to_ground(GRID, 0.0).geodetic, expected)


@pytest.mark.parametrize("suffix", ["IMD", "EPH", "ATT", "GEO"])
def test_text_set_with_a_missing_file(tmp_path: Path, suffix: str) -> None:
    imd = as_text_set(make_isd(), tmp_path)
    imd.with_suffix(f".{suffix}").unlink()
    start = imd.with_suffix(".GEO" if suffix != "GEO" else ".EPH")
    with pytest.raises(MissingFileError, match=rf"\.{suffix}"):
        digitalglobe.read(source_of(start))


@pytest.mark.parametrize("suffix", ["IMD", "EPH", "ATT", "GEO", "TIL"])
@pytest.mark.parametrize("part", [0.3, 0.8, 0.99])
def test_truncated_text(tmp_path: Path, suffix: str, part: float) -> None:
    imd = as_text_set(make_isd(), tmp_path)
    path = imd.with_suffix(f".{suffix}")
    text = path.read_text().removesuffix("END;\n")
    path.write_text(text[: int(part * len(text))])
    with pytest.raises(ProductError, match=rf"\.{suffix}: line \d+: ") as caught:
        digitalglobe.read(source_of(imd))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("END_GROUP = IMAGE_1", "END_GROUP = IMAGE_2", "line"),
        ("END_GROUP = IMAGE_1\n", "", "line"),
        ("BEGIN_GROUP = IMAGE_1\n", "", "line"),
        ("TLCList = (", "TLCList = (7 ", "TLCList"),
        ("numRows = ", "numRows : ", "line"),
        ("numRows = ", "numRows = 17;\nnumRows = ", "numRows"),
        ("numRows = ", "BEGIN_GROUP = A\n" * 40 + "numRows = ", "nested"),
        ("numRows = ", "\x00\x01", "line"),
    ],
)
def test_malformed_text(tmp_path: Path, old: str, new: str, place: str) -> None:
    imd = as_text_set(make_isd(), tmp_path)
    text = imd.read_text()
    assert old in text
    imd.write_text(text.replace(old, new, 1))
    with pytest.raises(ProductError, match=place):
        digitalglobe.read(source_of(imd))


def test_binary_and_empty_text(tmp_path: Path) -> None:
    imd = as_text_set(make_isd(), tmp_path)
    source = source_of(imd)
    imd.write_bytes(b"\xff\xfe\x00numRows = 3;")
    with pytest.raises(ProductError, match="plain text"):
        digitalglobe.read(source)
    imd.write_bytes(b"")
    with pytest.raises(ProductError, match="empty"):
        digitalglobe.read(source)


# Hostile input -------------------------------------------------------------------------------

NEEDED = [
    "IMD/NUMROWS",
    "IMD/NUMCOLUMNS",
    "IMD/PRODUCTLEVEL",
    "IMD/BANDID",
    "IMD/IMAGE",
    "IMD/IMAGE/SATID",
    "IMD/IMAGE/SCANDIRECTION",
    "IMD/IMAGE/TLCTIME",
    "IMD/IMAGE/NUMTLC",
    "IMD/IMAGE/TLCLISTList",
    "IMD/IMAGE/FIRSTLINETIME",
    *(
        f"{group}/{tag}"
        for group, rows in (("EPH", "EPHEMLIST"), ("ATT", "ATTLIST"))
        for tag in ("SATID", "STARTTIME", "NUMPOINTS", "TIMEINTERVAL", f"{rows}List")
    ),
    "GEO/SATID",
    "GEO/GEOMODELLEVEL",
    "GEO/PRINCIPAL_DISTANCE",
    "GEO/PRINCIPAL_DISTANCE/PD",
    "GEO/OPTICAL_DISTORTION",
    "GEO/OPTICAL_DISTORTION/POLYORDER",
    "GEO/PERSPECTIVE_CENTER",
    "GEO/PERSPECTIVE_CENTER/CX",
    "GEO/PERSPECTIVE_CENTER/CZ",
    "GEO/CAMERA_ATTITUDE",
    "GEO/CAMERA_ATTITUDE/QCS1",
    "GEO/CAMERA_ATTITUDE/QCS4",
    "GEO/DETECTOR_MOUNTING",
    "GEO/DETECTOR_MOUNTING/BAND_P",
    "GEO/DETECTOR_MOUNTING/BAND_P/DETECTOR_ARRAY",
    *(
        f"GEO/DETECTOR_MOUNTING/BAND_P/DETECTOR_ARRAY/{tag}"
        for tag in ("DETORIGINX", "DETORIGINY", "DETROTANGLE", "DETPITCH")
    ),
    "TIL/TILE/FILENAME",
    "TIL/TILE/ULROWOFFSET",
]


def refuses(isd: ET.Element, folder: Path, form: str, tag: str) -> None:
    with pytest.raises(ProductError) as caught:
        read_isd(isd, folder, form)
    message = str(caught.value)
    assert message.startswith(str(folder / STEM))
    assert tag.upper() in message.upper()
    assert "\n" not in message


@forms
@pytest.mark.parametrize("path", NEEDED)
def test_missing_tag(tmp_path: Path, form: str, path: str) -> None:
    tag = path.rpartition("/")[2].removesuffix("List")
    # Without its only band, the mounting has no detectors.
    refuses(drop(make_isd(), path), tmp_path, form, tag if tag != "BAND_P" else "DETECTOR")


@pytest.mark.parametrize("part", ["IMD", "EPH", "ATT", "GEO"])
def test_missing_part_of_the_xml(tmp_path: Path, part: str) -> None:
    refuses(drop(make_isd(), part), tmp_path, "xml", f"isd/{part}: this tag is missing")


def _row(path: str, row: int, column: int, text: str) -> Callable[[ET.Element], None]:
    def change(isd: ET.Element) -> None:
        entry = find(isd, path)[row]
        words = (entry.text or "").split()
        words[column] = text
        entry.text = " ".join(words)

    return change


def _text(path: str, text: str) -> Callable[[ET.Element], None]:
    def change(isd: ET.Element) -> None:
        find(isd, path).text = text

    return change


def _rows(path: str, act: Callable[[ET.Element], None]) -> Callable[[ET.Element], None]:
    return lambda isd: act(find(isd, path))


def _swap(rows: ET.Element) -> None:
    rows[4].text, rows[5].text = rows[5].text, rows[4].text


EPHEMERIS, ATTITUDE = "EPH/EPHEMLISTList", "ATT/ATTLISTList"
MUTATIONS = {
    "points too many": (_text("EPH/NUMPOINTS", "102"), "EPHEMLIST"),
    "points too few": (_text("ATT/NUMPOINTS", "100"), "ATTLIST"),
    "points not whole": (_text("ATT/NUMPOINTS", "100.5"), "NUMPOINTS"),
    "points negative": (_text("ATT/NUMPOINTS", "-1"), "ATTLIST"),
    "row lost": (_rows(EPHEMERIS, lambda rows: rows.remove(rows[7])), "EPHEMLIST"),
    "rows all lost": (_rows(ATTITUDE, lambda rows: rows.clear()), "ATTLIST"),
    "rows swapped": (_rows(ATTITUDE, _swap), "ATTLIST: entries numbered"),
    "index repeated": (_row(EPHEMERIS, 5, 0, "5.0"), "EPHEMLIST: entries numbered"),
    "position nan": (_row(EPHEMERIS, 5, 1, "nan"), "EPHEMLIST: entry 6: finite"),
    "position infinite": (_row(EPHEMERIS, 5, 2, "1e400"), "EPHEMLIST: entry 6: finite"),
    "position in km": (_row(EPHEMERIS, 5, 1, "7078.137"), "EPHEMLIST: entry 6: orbit position"),
    "position jumps": (_row(EPHEMERIS, 5, 2, "5.0"), "EPHEMLIST: velocities"),
    "velocity wrong": (_row(EPHEMERIS, 50, 6, "1.0"), "EPHEMLIST: velocities"),
    "text in a row": (_row(EPHEMERIS, 5, 3, "x7"), "EPHEMLIST: entry 6: number(s)"),
    "row too short": (
        _rows(EPHEMERIS, lambda rows: setattr(rows[3], "text", "4 5 6")),
        "EPHEMLIST: entry 4: 13 number",
    ),
    "row empty": (_rows(ATTITUDE, lambda rows: setattr(rows[3], "text", "")), "ATTLIST: entry 4"),
    "quaternion zero": (
        _rows(ATTITUDE, lambda rows: setattr(rows[3], "text", "4" + " 0.0" * 14)),
        "ATTLIST: entry 4: a unit quaternion",
    ),
    "quaternion denormal": (
        _rows(ATTITUDE, lambda rows: setattr(rows[3], "text", "4" + " 1e-310" * 14)),
        "ATTLIST: entry 4: a unit quaternion",
    ),
    "quaternion of another time": (
        _rows(
            ATTITUDE,
            lambda rows: setattr(rows[3], "text", "4 0.0 0.0 0.0 1.0" + " 0.0" * 10),
        ),
        "ATTLIST: entries 3 and 4",
    ),
    "variance negative": (_row(ATTITUDE, 3, 5, "-1e-9"), "ATTLIST: entry 4: a covariance"),
    "interval zero": (_text("EPH/TIMEINTERVAL", "0.0"), "TIMEINTERVAL"),
    "interval negative": (_text("ATT/TIMEINTERVAL", "-0.02"), "TIMEINTERVAL"),
    "interval nan": (_text("ATT/TIMEINTERVAL", "nan"), "TIMEINTERVAL"),
    "interval wrong": (_text("EPH/TIMEINTERVAL", "0.04"), "EPHEMLIST: velocities"),
    "start not a time": (_text("EPH/STARTTIME", "yesterday"), "STARTTIME"),
    "start of another day": (_text("ATT/STARTTIME", "2020-01-02T00:00:00Z"), "STARTTIME"),
    "start too late": (_text("EPH/STARTTIME", "2020-01-01T00:00:01Z"), "STARTTIME"),
    "level unknown": (_text("IMD/PRODUCTLEVEL", "LV0"), "PRODUCTLEVEL"),
    "satellites differ": (_text("ATT/SATID", "WV03"), "SATID"),
    "satellite unknown": (_text("IMD/IMAGE/SATID", "XX09"), "SATID"),
    "rows none": (_text("IMD/NUMROWS", "0"), "NUMROWS"),
    "rows not whole": (_text("IMD/NUMROWS", "7.5"), "NUMROWS"),
    "columns text": (_text("IMD/NUMCOLUMNS", "many"), "NUMCOLUMNS"),
    "columns without end": (_text("IMD/NUMCOLUMNS", "1e300"), "NUMCOLUMNS"),
    "line times flat": (_row("IMD/IMAGE/TLCLISTList", 1, 1, "0.0"), "TLCLIST"),
    "line times unsorted": (_row("IMD/IMAGE/TLCLISTList", 1, 0, "-5"), "TLCLIST"),
    "line times too few": (_text("IMD/IMAGE/NUMTLC", "3"), "TLCLIST"),
    "line time infinite": (_row("IMD/IMAGE/TLCLISTList", 1, 1, "inf"), "TLCLIST"),
    "scan sideways": (_text("IMD/IMAGE/SCANDIRECTION", "Sideways"), "SCANDIRECTION"),
    "focal length": (_text("GEO/PRINCIPAL_DISTANCE/PD", "-3.0"), "PD"),
    "focal length tiny": (_text("GEO/PRINCIPAL_DISTANCE/PD", "1e-310"), "PD"),
    "line time in microseconds": (_row("IMD/IMAGE/TLCLISTList", 1, 1, "8e5"), "TLCLIST"),
    "position absurd": (_row(EPHEMERIS, 5, 2, "1e300"), "EPHEMLIST: entry 6: finite"),
    "pitch": (_text("GEO/DETECTOR_MOUNTING/BAND_P/DETECTOR_ARRAY/DETPITCH", "0"), "DETPITCH"),
    "mounting": (_text("GEO/CAMERA_ATTITUDE/QCS4", "0.0"), "QCS1"),
    "lever arm in mm": (_text("GEO/PERSPECTIVE_CENTER/CX", "1500.0"), "CX"),
    "camera of another level": (_text("GEO/GEOMODELLEVEL", "LV0"), "GEOMODELLEVEL"),
    "tile outside": (_text("TIL/TILE/LRROWOFFSET", "99999"), "TILE"),
    "corner text": (_text("IMD/BAND_P/ULLON", "west"), "ULLON"),
}


@forms
@pytest.mark.parametrize("name", MUTATIONS)
def test_mutated(tmp_path: Path, form: str, name: str) -> None:
    change, tag = MUTATIONS[name]
    isd = make_isd()
    change(isd)
    refuses(isd, tmp_path, form, tag)


@forms
def test_several_arrays_and_images_are_not_supported(tmp_path: Path, form: str) -> None:
    for path in ("GEO/DETECTOR_MOUNTING/BAND_P/DETECTOR_ARRAY", "IMD/IMAGE"):
        isd = make_isd()
        parent = find(isd, path.rpartition("/")[0])
        parent.append(ET.fromstring(ET.tostring(find(isd, path))))
        with pytest.raises(UnsupportedError, match=path.rpartition("/")[2]):
            read_isd(isd, tmp_path, form)


def test_looking_away_from_the_earth(tmp_path: Path) -> None:
    isd = make_isd()
    for i, value in enumerate((1.0, 0.0, 0.0, 0.0), start=1):
        find(isd, f"GEO/CAMERA_ATTITUDE/QCS{i}").text = str(value)
    refuses(isd, tmp_path, "xml", "miss the Earth")


@pytest.mark.parametrize("part", [0.0, 0.2, 0.7, 0.999])
def test_truncated_xml(tmp_path: Path, part: float) -> None:
    whole = ET.tostring(make_isd())
    path = tmp_path / f"{STEM}.XML"
    path.write_bytes(whole[: int(part * len(whole))])
    with pytest.raises(ProductError, match=STEM):
        digitalglobe.read(source_of(path))


def test_entity_bomb_and_deep_nesting(tmp_path: Path) -> None:
    path = tmp_path / f"{STEM}.XML"
    path.write_text(
        '<!DOCTYPE isd [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><isd><IMD>&b;</IMD></isd>'
    )
    with pytest.raises(ProductError, match="refused"):
        digitalglobe.read(source_of(path))
    path.write_text("<isd>" + "<A>" * 5000 + "</A>" * 5000 + "</isd>")
    with pytest.raises(ProductError, match="nested"):
        digitalglobe.read(source_of(path))


def test_isd_of_something_else(tmp_path: Path) -> None:
    path = tmp_path / f"{STEM}.XML"
    path.write_text("<isd><DELIVERY>README</DELIVERY></isd>")
    with pytest.raises(ProductError, match="IMD"):
        digitalglobe.read(source_of(path))
    path.write_text("<dimap/>")
    with pytest.raises(ProductError, match="root element isd"):
        digitalglobe.read(source_of(path))
