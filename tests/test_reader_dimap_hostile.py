"""Broken and foreign DIMAP files, made from real ones: always one line that names file and tag."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import pytest

from geoposition.errors import GeopositionError, MissingFileError, ProductError, UnsupportedError
from geoposition.product import Product
from geoposition.sensors.readers import dimap_v1, dimap_v2, pleiades_system
from geoposition.sensors.readers.source import Source

PLEIADES = "linescan/pleiades1a/IMG_PHR1A_P_001/DIM_PHR1A_P_202108271549303_SEN_5897098101-1.XML"
FILES: dict[str, tuple[ModuleType, str]] = {
    "pleiades": (dimap_v2, PLEIADES),
    "spot6": (dimap_v2, "linescan/spot6/SPOT6.XML"),
    "spot5": (dimap_v1, "linescan/spot5_hrs/spot_example1.xml"),
    "system": (pleiades_system, "grids/PHRDIMAP_P1BP--2018122638935449CP.XML"),
}

REFINED = "Geometric_Data/Refined_Model"
CALIBRATION = f"{REFINED}/Geometric_Calibration/Instrument_Calibration"
BAND = f"{CALIBRATION}/Band_Calibration_List/Band_Calibration"
V2_TAGS = [
    "Metadata_Identification/METADATA_PROFILE",
    "Raster_Data/Raster_Dimensions",
    "Raster_Data/Raster_Dimensions/NROWS",
    "Raster_Data/Raster_Dimensions/NCOLS",
    REFINED,
    f"{REFINED}/Time",
    f"{REFINED}/Time/Time_Range/START",
    f"{REFINED}/Time/Time_Range/END",
    f"{REFINED}/Time/Time_Stamp/LINE_PERIOD",
    f"{REFINED}/Ephemeris",
    f"{REFINED}/Ephemeris/Point_List",
    f"{REFINED}/Ephemeris/Point_List/Point/LOCATION_XYZ",
    f"{REFINED}/Ephemeris/Point_List/Point/VELOCITY_XYZ",
    f"{REFINED}/Ephemeris/Point_List/Point/TIME",
    f"{REFINED}/Attitudes",
    f"{REFINED}/Geometric_Calibration",
    CALIBRATION,
]
PLEIADES_QUATERNIONS = f"{REFINED}/Attitudes/Polynomial_Quaternions"
SPOT6_QUATERNION = f"{REFINED}/Attitudes/Quaternion_List/Quaternion"
TAGS = {
    "pleiades": [
        *V2_TAGS,
        *(f"{PLEIADES_QUATERNIONS}/{tag}" for tag in ("OFFSET", "SCALE", "Q0", "Q1", "Q2", "Q3")),
        f"{PLEIADES_QUATERNIONS}/Q2/COEFFICIENTS",
        f"{CALIBRATION}/Swath_Range",
        f"{CALIBRATION}/Swath_Range/FIRST_COL",
        f"{CALIBRATION}/Polynomial_Look_Angles",
        *(f"{CALIBRATION}/Polynomial_Look_Angles/{tag}" for tag in ("XLOS_0", "XLOS_1", "YLOS_0")),
    ],
    "spot6": [
        *V2_TAGS,
        f"{REFINED}/Attitudes/Quaternion_List",
        *(f"{SPOT6_QUATERNION}/{tag}" for tag in ("Q0", "Q1", "Q2", "Q3", "TIME")),
        f"{BAND}/Swath_Range/FIRST_COL",
        *(f"{BAND}/Polynomial_Look_Angles/{tag}" for tag in ("XLOS_0", "XLOS_1", "YLOS_0")),
    ],
    "spot5": [
        "Metadata_Id/METADATA_PROFILE",
        "Raster_Dimensions/NROWS",
        "Raster_Dimensions/NCOLS",
        "Data_Processing/PROCESSING_LEVEL",
        "Dataset_Sources/Source_Information/Scene_Source/MISSION",
        "Dataset_Sources/Source_Information/Scene_Source/MISSION_INDEX",
        "Data_Strip",
        "Data_Strip/Ephemeris/Points",
        "Data_Strip/Ephemeris/Points/Point/Location",
        "Data_Strip/Ephemeris/Points/Point/Location/Y",
        "Data_Strip/Ephemeris/Points/Point/Velocity/Z",
        "Data_Strip/Ephemeris/Points/Point/TIME",
        "Data_Strip/Satellite_Attitudes",
        *(
            f"Data_Strip/Satellite_Attitudes/Corrected_Attitudes/Corrected_Attitude/Angles/{tag}"
            for tag in ("TIME", "YAW", "PITCH", "ROLL")
        ),
        *(
            f"Data_Strip/Sensor_Configuration/Time_Stamp/{tag}"
            for tag in ("LINE_PERIOD", "SCENE_CENTER_TIME", "SCENE_CENTER_LINE")
        ),
        "Data_Strip/Sensor_Configuration/Instrument_Look_Angles_List",
        *(
            "Data_Strip/Sensor_Configuration/Instrument_Look_Angles_List/Instrument_Look_Angles/"
            f"Look_Angles_List/Look_Angles/{tag}"
            for tag in ("DETECTOR_ID", "PSI_X", "PSI_Y")
        ),
    ],
    "system": [
        "Product_Characteristics/PROCESSING_LEVEL",
        "Raster_Dimensions/NROWS",
        "Raster_Dimensions/NCOLS",
        *(
            f"Geometric_Data/Sensor_Model_Characteristics/{tag}"
            for tag in (
                "UTC_Sensor_Model_Range/START",
                "UTC_Sensor_Model_Range/END",
                "SENSOR_LINE_PERIOD",
                "Sensor_Ephemeris/Point_List",
                "Sensor_Ephemeris/Point_List/Point/LOCATION_VALUES",
                "Sensor_Ephemeris/Point_List/Point/UTC_TIME",
                "Sensor_Attitudes/OFFSET",
                "Sensor_Attitudes/SCALE",
                "Sensor_Attitudes/Polynomial_Models/Q0",
                "Sensor_Attitudes/Polynomial_Models/Q3/COEFFICIENTS",
                "Sensor_Viewing_Model/Position_In_Retina/FIRST_COL",
                "Sensor_Viewing_Model/Viewing_Directions/PsiX_Model",
                "Sensor_Viewing_Model/Viewing_Directions/PsiY_Model/COEFFICIENTS",
            )
        ),
        *(
            f"Geoposition/Rational_Sensor_Model/Global_RFM/{tag}"
            for tag in ("Inverse_Model/F_ROW", "RFM_Validity/Lon/A", "RFM_Validity/Row/B")
        ),
    ],
}


@pytest.fixture(scope="module")
def originals() -> dict[str, bytes]:
    return {}


@pytest.fixture
def mutated(
    real_data: Path, tmp_path: Path, originals: dict[str, bytes]
) -> Callable[[str, Callable[[Element], None]], Product]:
    """Read a copy of a real file after a change, alone in its folder."""

    def apply(name: str, change: Callable[[Element], None]) -> Product:
        module, file = FILES[name]
        root = ElementTree.fromstring(originals.setdefault(name, (real_data / file).read_bytes()))
        change(root)
        path = tmp_path / "CHANGED.XML"
        path.write_bytes(ElementTree.tostring(root))
        return module.read(Source.of(path))

    return apply


def refusal(run: Callable[[], object]) -> ProductError:
    with pytest.raises(ProductError) as caught:
        run()
    message = str(caught.value)
    assert "\n" not in message
    assert "CHANGED.XML" in message
    return caught.value


def drop(tags: str) -> Callable[[Element], None]:
    parent, _, tag = tags.rpartition("/")

    def change(root: Element) -> None:
        element = root.find(parent) if parent else root
        assert element is not None
        child = element.find(tag)
        assert child is not None, tags
        element.remove(child)

    return change


def put(tags: str, text: str, **attributes: str) -> Callable[[Element], None]:
    def change(root: Element) -> None:
        element = root.find(tags)
        assert element is not None, tags
        element.text = text
        element.attrib.update(attributes)

    return change


@pytest.mark.parametrize(("name", "tags"), [(n, t) for n, tags in TAGS.items() for t in tags])
def test_a_missing_tag_is_named(mutated: Callable[..., Product], name: str, tags: str) -> None:
    error = refusal(lambda: mutated(name, drop(tags)))
    assert (
        tags.rpartition("/")[2] in error.place
        or tags.rpartition("/")[2] in error.expected
        or (
            # A Point without a child is named by its own place.
            tags.rpartition("/")[0].rpartition("/")[2] in error.place
        )
    )


NUMBERS = [
    ("pleiades", "Raster_Data/Raster_Dimensions/NROWS"),
    ("pleiades", f"{REFINED}/Time/Time_Stamp/LINE_PERIOD"),
    ("pleiades", f"{PLEIADES_QUATERNIONS}/OFFSET"),
    ("pleiades", f"{PLEIADES_QUATERNIONS}/Q1/COEFFICIENTS"),
    ("pleiades", f"{CALIBRATION}/Swath_Range/FIRST_COL"),
    ("pleiades", f"{CALIBRATION}/Polynomial_Look_Angles/XLOS_1"),
    ("spot6", f"{REFINED}/Ephemeris/Point_List/Point/LOCATION_XYZ"),
    ("spot6", f"{SPOT6_QUATERNION}/Q2"),
    ("spot5", "Data_Strip/Ephemeris/Points/Point/Location/X"),
    (
        "spot5",
        "Data_Strip/Satellite_Attitudes/Corrected_Attitudes/Corrected_Attitude/Angles/PITCH",
    ),
    ("spot5", "Data_Strip/Sensor_Configuration/Time_Stamp/SCENE_CENTER_LINE"),
    ("system", "Geometric_Data/Sensor_Model_Characteristics/Sensor_Attitudes/SCALE"),
    ("system", "Geoposition/Rational_Sensor_Model/Global_RFM/Inverse_Model/F_COL"),
]


@pytest.mark.parametrize("text", ["NaN", "inf", "", "twelve", "1 2"])
@pytest.mark.parametrize(("name", "tags"), NUMBERS)
def test_numbers_that_are_none(
    mutated: Callable[..., Product], name: str, tags: str, text: str
) -> None:
    error = refusal(lambda: mutated(name, put(tags, text)))
    assert tags.rpartition("/")[2] in error.place


@pytest.mark.parametrize("text", ["1e308", "-1e308"])
@pytest.mark.parametrize(("name", "tags"), NUMBERS)
def test_numbers_out_of_all_bounds(
    mutated: Callable[..., Product], name: str, tags: str, text: str
) -> None:
    """No overflow, no warning on the way to the refusal."""
    if tags.endswith(("COEFFICIENTS", "F_COL")):
        text = " ".join([text] * (40 if tags.endswith("F_COL") else 4))
    elif tags.endswith("LOCATION_XYZ"):
        text = " ".join([text] * 3)
    if tags.endswith("SCALE") and text[0] != "-":
        return  # a constant attitude: odd, and no contradiction
    refusal(lambda: mutated(name, put(tags, text)))


@pytest.mark.parametrize(
    ("name", "tags", "text", "expected"),
    [
        ("pleiades", "Raster_Data/Raster_Dimensions/NCOLS", "0", "image size"),
        ("pleiades", "Raster_Data/Raster_Dimensions/NCOLS", "-3", "image size"),
        ("pleiades", "Raster_Data/Raster_Dimensions/NROWS", "1e12", "image size"),
        ("pleiades", "Raster_Data/Raster_Dimensions/NROWS", "7.5", "whole number"),
        ("pleiades", f"{REFINED}/Time/Time_Stamp/LINE_PERIOD", "-0.07", "line period"),
        ("pleiades", f"{REFINED}/Time/Time_Stamp/LINE_PERIOD", "73.5", "wrong unit"),
        ("pleiades", f"{REFINED}/Time/Time_Range/START", "yesterday", "UTC like"),
        ("pleiades", f"{REFINED}/Time/Time_Range/START", "2021-13-27T15:49:30Z", "no such date"),
        ("pleiades", f"{REFINED}/Time/Time_Range/END", "2021-08-27T15:49:29Z", "END after"),
        ("pleiades", f"{PLEIADES_QUATERNIONS}/OFFSET", "50000", "near the image"),
        ("pleiades", f"{PLEIADES_QUATERNIONS}/SCALE", "0", "above 0"),
        ("pleiades", f"{PLEIADES_QUATERNIONS}/Q0/DEGREE", "4", "5 numbers"),
        ("pleiades", f"{PLEIADES_QUATERNIONS}/Q0/COEFFICIENTS", "0.9 0 0 0", "unit quaternions"),
        ("pleiades", f"{CALIBRATION}/Polynomial_Look_Angles/XLOS_1", "0.01", "tangents"),
        ("pleiades", f"{CALIBRATION}/Instrument_Biases/YAW", "much", "number(s) expected"),
        ("spot6", f"{REFINED}/Ephemeris/Point_List/Point/LOCATION_XYZ", "1 2 3", "low orbit"),
        ("spot6", f"{SPOT6_QUATERNION}/Q0", "0.7", "unit norm"),
        ("spot5", "Raster_Dimensions/NROWS", "0", "image size"),
        (
            "spot5",
            "Data_Strip/Sensor_Configuration/Time_Stamp/SCENE_CENTER_TIME",
            "2009-03-04T12:31:39",
            "around the time",
        ),
    ],
)
def test_impossible_values(
    mutated: Callable[..., Product], name: str, tags: str, text: str, expected: str
) -> None:
    assert expected in str(refusal(lambda: mutated(name, put(tags, text))))


TABLES = {
    "pleiades": (f"{REFINED}/Ephemeris/Point_List", "Point", "TIME"),
    "spot6": (f"{REFINED}/Attitudes/Quaternion_List", "Quaternion", "TIME"),
    "spot5": (
        "Data_Strip/Satellite_Attitudes/Corrected_Attitudes/Corrected_Attitude", "Angles", "TIME",
    ),
    "system": (
        "Geometric_Data/Sensor_Model_Characteristics/Sensor_Ephemeris/Point_List",
        "Point",
        "UTC_TIME",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("order", ["repeated", "swapped"])
def test_repeated_and_unsorted_times(
    mutated: Callable[..., Product], name: str, order: str
) -> None:
    parent, tag, time = TABLES[name]

    def change(root: Element) -> None:
        entries = root.find(parent).findall(tag)
        first, second = entries[2].find(time), entries[3].find(time)
        if order == "repeated":
            second.text = first.text
        else:
            first.text, second.text = second.text, first.text

    error = refusal(lambda: mutated(name, change))
    assert "increasing" in error.expected
    assert error.place.endswith(parent.rpartition("/")[2])


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("left", [0, 1])
def test_tables_cut_short(mutated: Callable[..., Product], name: str, left: int) -> None:
    parent, tag, _ = TABLES[name]

    def change(root: Element) -> None:
        element = root.find(parent)
        for entry in element.findall(tag)[left:]:
            element.remove(entry)

    refusal(lambda: mutated(name, change))


def test_units_are_honoured_and_unknown_ones_refused(mutated: Callable[..., Product]) -> None:
    stamp = f"{REFINED}/Time/Time_Stamp/LINE_PERIOD"
    plain = mutated("pleiades", put(stamp, "0.0735"))
    for text, unit in (("73.5", "us"), ("0.0735", "ms"), ("7.35e-5", "s"), ("73.5", "Microsecond")):
        product = mutated("pleiades", put(stamp, text, unit=unit))
        assert product.details["line_period_s"] == pytest.approx(7.35e-5, rel=1e-12)
        assert product.model.shape == plain.model.shape
    error = refusal(lambda: mutated("pleiades", put(stamp, "73.5", unit="fortnight")))
    assert "fortnight" in str(error)

    def kilometres(root: Element) -> None:
        for node in root.iter("LOCATION_XYZ"):
            node.text = " ".join(repr(float(word) / 1000.0) for word in node.text.split())
            node.set("unit", "km")

    in_km = mutated("pleiades", kilometres).model.ephemeris
    assert in_km.position_m(0.5) == pytest.approx(plain.model.ephemeris.position_m(0.5), abs=1e-6)


@pytest.mark.parametrize(
    ("name", "tags", "text", "expected"),
    [
        ("pleiades", "Metadata_Identification/METADATA_PROFILE", "PHR_ORTHO", "map-projected"),
        ("pleiades", "Metadata_Identification/METADATA_PROFILE", "PNEO_SENSOR", "never checked"),
        ("pleiades", "Metadata_Identification/METADATA_SUBPROFILE", "STRIP", "PRODUCT expected"),
        ("pleiades", "Geoposition/Raster_CRS/RASTER_GEOMETRY", "RECTIFIED", "SENSOR expected"),
        (
            "spot6",
            "Processing_Information/Product_Settings/PROCESSING_LEVEL",
            "ORTHO",
            "SENSOR expected",
        ),
        ("spot5", "Data_Processing/PROCESSING_LEVEL", "1B", "resampled"),
        ("spot5", "Dataset_Sources/Source_Information/Scene_Source/MISSION", "FORMOSAT", "SPOT 1"),
        ("system", "Product_Characteristics/PROCESSING_LEVEL", "ORTHO", "SENSOR expected"),
    ],
)
def test_other_products_are_unsupported(
    mutated: Callable[..., Product], name: str, tags: str, text: str, expected: str
) -> None:
    error = refusal(lambda: mutated(name, put(tags, text)))
    assert isinstance(error, UnsupportedError)
    assert expected in str(error)


@pytest.mark.parametrize("name", FILES)
def test_truncated_empty_and_bomb(name: str, real_data: Path, tmp_path: Path) -> None:
    module, file = FILES[name]
    whole = (real_data / file).read_bytes()
    path = tmp_path / "CHANGED.XML"
    for part in (0, 1, len(whole) // 3, len(whole) - 20):
        path.write_bytes(whole[:part])
        refusal(lambda: module.read(Source.of(path)))
    tag = Source.of(real_data / file).xml_root
    bomb = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]>'
    path.write_text(f"{bomb}<{tag}>&b;</{tag}>")
    assert "entities" in str(refusal(lambda: module.read(Source.of(path))))
    path.write_text(f"<{tag}/>")
    refusal(lambda: module.read(Source.of(path)))
    with pytest.raises(MissingFileError):
        module.read(Source(tmp_path / "none.XML", b"", tag))


def test_instrument_biases_are_told_not_applied(mutated: Callable[..., Product]) -> None:
    product = mutated("pleiades", put(f"{CALIBRATION}/Instrument_Biases/YAW", "0.1"))
    assert any("biases" in note for note in product.details["notes"])


def test_of_several_bands_the_panchromatic_or_the_first(mutated: Callable[..., Product]) -> None:
    def second_band(name: str) -> Callable[[Element], None]:
        def change(root: Element) -> None:
            bands = root.find(f"{CALIBRATION}/Band_Calibration_List")
            other = ElementTree.fromstring(ElementTree.tostring(bands[0]))
            bands[0].find("BAND_ID").text = "B0"
            other.find("BAND_ID").text = name
            other.find("Polynomial_Look_Angles/YLOS_0").text = "0.001"
            bands.append(other)

        return change

    product = mutated("spot6", second_band("P"))
    assert product.details["band"] == "P"
    assert product.model.camera.tangents(0, 0.0)[0] == 0.001
    product = mutated("spot6", second_band("B1"))
    assert product.details["band"] == "B0"
    assert product.model.camera.tangents(0, 0.0)[0] == 0.0
    assert any("B0, of B0, B1" in note for note in product.details["notes"])


def test_first_col_shifts_the_look_angles(mutated: Callable[..., Product]) -> None:
    """Column c of a swath that begins at FIRST_COL looks where c + FIRST_COL - 1 looks."""
    whole = mutated("spot6", lambda root: None).model.camera
    crop = mutated("spot6", put(f"{BAND}/Swath_Range/FIRST_COL", "1001")).model.camera
    assert crop.tangents(0, 5.0) == pytest.approx(whole.tangents(0, 1005.0), abs=1e-15)


def test_tiles_are_read_through_the_metadata(
    mutated: Callable[..., Product], tmp_path: Path
) -> None:
    files = "Raster_Data/Data_Access/Data_Files"

    def two_tiles(root: Element) -> None:
        second = ElementTree.SubElement(root.find(files), "Data_File", tile_R="1", tile_C="2")
        ElementTree.SubElement(second, "DATA_FILE_PATH", href="R1C2.TIF")

    name = "IMG_SPOT6_P_201809151819247_SEN_4555226101_R1C1.TIF"
    assert mutated("spot6", lambda root: None).image_path is None
    (tmp_path / name).touch()
    assert mutated("spot6", lambda root: None).image_path == tmp_path / name
    assert mutated("spot6", two_tiles).image_path is None
    (tmp_path / "R1C2.TIF").touch()
    product = mutated("spot6", two_tiles)
    assert product.image_path == product.path
    assert any("2 tiles" in note for note in product.details["notes"])


def test_each_reader_knows_its_own_files_only(real_data: Path) -> None:
    for name, (own, file) in FILES.items():
        source = Source.of(real_data / file)
        knowing = [m for m in (dimap_v1, dimap_v2, pleiades_system) if m.recognises(source)]
        assert knowing == [own], name


def test_a_volume_without_its_images(real_data: Path, tmp_path: Path) -> None:
    path = tmp_path / "VOL_PHR.XML"
    path.write_bytes((real_data / "linescan/pleiades1a/VOL_PHR.XML").read_bytes())
    with pytest.raises(MissingFileError, match=r"none of its images is there \(DIM_PHR1A_P"):
        dimap_v2.read(Source.of(path))
    text = path.read_text().replace('href="IMG_', 'href="../../IMG_')
    path.write_text(text)
    with pytest.raises(MissingFileError):
        dimap_v2.read(Source.of(path))


@pytest.mark.parametrize("name", FILES)
def test_random_damage_never_escapes_the_error_family(
    mutated: Callable[..., Product], name: str
) -> None:
    """Elements dropped, doubled or given nonsense anywhere: a product or a `ProductError`."""
    chance = random.Random(7)
    nonsense = ["", "NaN", "-1", "0", "1e308", "é", "2021-08-27T25:00:00Z", "1 2 3 4 5 6 7"]

    def change(root: Element) -> None:
        for _ in range(3):
            # Half of the damage where the geometry is, not in histograms.
            tags = [TAGS[name][chance.randrange(len(TAGS[name]))].rpartition("/")[0] or "."]
            parents = [p for p in root.iterfind(tags[0]) if len(p)] or [root]
            parent = chance.choice(parents)
            child = chance.choice(list(parent))
            act = chance.randrange(3)
            if act == 0:
                parent.remove(child)
            elif act == 1:
                parent.append(child)
            else:
                child.text = chance.choice(nonsense)

    outcomes = set()
    for _ in range(15):
        try:
            outcomes.add(type(mutated(name, change)))
        except GeopositionError as error:
            outcomes.add(type(error))
            broken = "\n" in str(error)
            if broken:
                pytest.fail(f"more than one line: {error}")
    assert outcomes <= {Product, ProductError, UnsupportedError}
    assert ProductError in outcomes
