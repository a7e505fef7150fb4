"""DIMAP v2 products at sensor level: Pleiades-1A/1B and SPOT 6/7.

The image is that of an ideal push-broom camera: constant line period, tangents of the look
angles as polynomials of the column, quaternions from the line-of-sight frame to WGS 84. Rows
and columns count from 1 in the file and from FIRST_COL in the swath; aberration and refraction
are contained in the attitude.

*Source*: Pleiades Imagery User Guide (Airbus, 2021), appendix on geometric modelling; the
conventions were checked against vendor RPCs and corner coordinates.
"""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray, read_only
from geoposition.corrections import NO_CORRECTIONS
from geoposition.errors import ProductError, UnsupportedError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.formats import read_rpc
from geoposition.rpc.model import RpcModel
from geoposition.sensors.directions import PolynomialDirections
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.readers.dimap_attitude import (
    polynomial_attitude,
    quaternion_list_attitude,
)
from geoposition.sensors.readers.dimap_files import image_file, rpc_file, volume_images
from geoposition.sensors.readers.dimap_orbit import read_orbit
from geoposition.sensors.readers.dimap_xml import (
    HEIGHT_RANGE_M,
    blamed_on,
    corners,
    epoch_at,
    image_shape,
    line_period_s,
)
from geoposition.sensors.readers.source import Source
from geoposition.sensors.timing import ConstantLineRate
from geoposition.xmlfile import XmlNode, read_xml

FORMAT: Final = "DIMAP v2 (Pleiades, SPOT 6/7)"
CANDIDATES: Final = (
    "DIM_*.XML", "dim_*.xml", "VOL_*.XML", "vol_*.xml", "**/DIM_*.XML", "**/dim_*.xml",
    "*.XML",
    "*.xml",
)  # fmt: skip

_SENSORS: Final = {"PHR_SENSOR": "Pleiades", "S6_SENSOR": "SPOT 6", "S7_SENSOR": "SPOT 7"}
_DEFAULT_PERIOD_UNIT: Final = {"PHR_SENSOR": "ms", "S6_SENSOR": "us", "S7_SENSOR": "us"}
_MOST_LOOK_ANGLE_DEGREE: Final = 9
_MOST_TAN: Final = 0.2
"""Half the field of view of any such camera, generously: beyond it units are wrong."""
_MOST_PROLONGED_LINES: Final = 2.0


def recognises(source: Source) -> bool:
    """Whether `source` is DIMAP v2 metadata other than an RPC file."""
    if source.xml_root != "Dimap_Document" or b"Metadata_Identification" not in source.head:
        return False
    return re.search(rb"METADATA_SUBPROFILE[^>]*>\s*RPC\s*<", source.head) is None


def read(source: Source) -> Product:
    """Read a product from its metadata file (DIM_*.XML) or its volume (VOL_*.XML)."""
    root = read_xml(source.path)
    notes: list[str] = []
    if root.text("Metadata_Identification/METADATA_PROFILE") == "VOLUME":
        images = volume_images(root)
        if len(images) > 1:
            others = ", ".join(path.name for path in images[1:])
            notes.append(f"the volume holds {len(images)} images; not read: {others}")
        root = read_xml(images[0])
    return _read_product(root, notes)


def _read_product(root: XmlNode, notes: list[str]) -> Product:
    profile = _sensor_profile(root)
    shape = image_shape(root.need("Raster_Data/Raster_Dimensions"))
    rpc_path, rpc_note = rpc_file(root)
    vendor_rpc = None if rpc_path is None else read_rpc(rpc_path).with_shape(shape)
    if rpc_note is not None:
        notes.append(rpc_note)
    image_path, image_notes = image_file(
        root.all("Raster_Data/Data_Access/Data_Files/Data_File/DATA_FILE_PATH"), root.path
    )
    notes += image_notes
    details: dict[str, object] = {
        "profile": profile,
        "corners": corners(root.all("Dataset_Content/Dataset_Extent/Vertex")),
    }
    refined = root.find("Geometric_Data/Refined_Model")
    model: PushbroomModel | RpcModel
    if refined is None and vendor_rpc is not None:
        notes.append("the metadata holds no rigorous model, its RPC stands in")
        model, start = vendor_rpc, None
    else:
        refined = root.need("Geometric_Data/Refined_Model")
        model = _model(refined, profile, shape, vendor_rpc, details, notes)
        start = model.camera.timing.epoch
    details["notes"] = tuple(notes)
    return Product(
        root.path,
        FORMAT,
        _sensor_name(root, profile),
        model,
        vendor_rpc,
        image_path,
        start,
        details,
    )


def _sensor_profile(root: XmlNode) -> str:
    profile_node = root.need("Metadata_Identification/METADATA_PROFILE")
    profile = profile_node.text()
    kind = root.find("Metadata_Identification/METADATA_SUBPROFILE")
    if kind is not None and kind.text() != "PRODUCT":
        raise UnsupportedError(
            kind.path, kind.place, f"PRODUCT expected (DIM_*.XML), this is {kind.text()!r}"
        )
    if profile not in _SENSORS:
        why = "its geometry was never checked against a known product"
        if profile.endswith(("ORTHO", "MOSAIC", "PROJECTED")):
            why = "a map-projected image has no sensor model"
        raise UnsupportedError(
            profile_node.path,
            profile_node.place,
            f"one of {', '.join(_SENSORS)} expected, this is {profile!r}: {why}",
        )
    for tags, expected in (
        ("Geoposition/Raster_CRS/RASTER_GEOMETRY", "SENSOR"),
        ("Geoposition/Raster_CRS/PIXEL_ORIGIN", "1"),
        ("Processing_Information/Product_Settings/PROCESSING_LEVEL", "SENSOR"),
    ):
        node = root.find(tags)
        if node is not None and node.text() != expected:
            raise UnsupportedError(
                node.path, node.place, f"{expected} expected, this is {node.text()!r}"
            )
    return profile


def _model(
    refined: XmlNode,
    profile: str,
    shape: tuple[int, int],
    vendor_rpc: RpcModel | None,
    details: dict[str, object],
    notes: list[str],
) -> PushbroomModel:
    time = refined.need("Time")
    epoch = epoch_at(time, "Time_Range/START")
    period_node = time.need("Time_Stamp/LINE_PERIOD")
    period = line_period_s(period_node, _DEFAULT_PERIOD_UNIT[profile])
    last = (shape[0] - 1) * period
    _check_duration(time, period_node, shape[0] * period)
    orbit = read_orbit(
        refined.need("Ephemeris/Point_List"), epoch, "LOCATION_XYZ", "VELOCITY_XYZ", "TIME"
    )
    # Tables may end with the image's first and last line: reach for their outer edges.
    orbit = orbit.prolonged(-period, last + period, _MOST_PROLONGED_LINES * period)
    attitudes = refined.need("Attitudes")
    polynomials, quaternions = (
        attitudes.find("Polynomial_Quaternions"),
        attitudes.find("Quaternion_List"),
    )
    if polynomials is not None:
        attitude, attitude_notes = polynomial_attitude(polynomials, epoch, -period, last + period)
        notes += attitude_notes
    elif quaternions is not None:
        attitude = quaternion_list_attitude(
            quaternions, epoch, -period, last + period, _MOST_PROLONGED_LINES * period
        )
    else:
        raise ProductError(
            attitudes.path, attitudes.place, "Polynomial_Quaternions or Quaternion_List expected"
        )
    directions = _directions(refined, shape[1], details, notes)
    details["line_period_s"] = period
    details["velocities_in_file"] = orbit.velocity_kind
    low, high = HEIGHT_RANGE_M if vendor_rpc is None else vendor_rpc.height_range_m
    with blamed_on(refined):
        camera = LineCamera.single(shape, ConstantLineRate(epoch, 0.0, period), directions)
        return PushbroomModel(camera, orbit.ephemeris(), attitude, NO_CORRECTIONS, (low, high))


def _check_duration(time: XmlNode, period_node: XmlNode, duration_s: float) -> None:
    """Refuse a line period ten times off what the time range says: a unit is wrong."""
    stated = epoch_at(time, "Time_Range/END") - epoch_at(time, "Time_Range/START")
    if stated <= 0:
        raise ProductError(time.path, f"{time.place}/Time_Range", "END after START expected")
    if not 0.1 < duration_s / stated < 10.0:
        raise ProductError(
            period_node.path,
            period_node.place,
            f"lines over {stated:g} s expected (Time_Range), these take {duration_s:g} s: "
            "wrong unit or wrong NROWS",
        )


def _directions(
    refined: XmlNode, samples: int, details: dict[str, object], notes: list[str]
) -> PolynomialDirections:
    """Look angles of the image; of several bands' the panchromatic's or else the first's."""
    instrument = refined.need("Geometric_Calibration/Instrument_Calibration")
    bands = instrument.all("Band_Calibration_List/Band_Calibration")
    chosen = instrument
    if bands:
        names = [band.text("BAND_ID") for band in bands]
        index = next((i for i, name in enumerate(names) if name in ("P", "PAN", "PA")), 0)
        chosen = bands[index]
        details["band"] = names[index]
        if len(bands) > 1:
            notes.append(f"look angles of band {names[index]}, of {', '.join(names)}")
    biases = instrument.find("Instrument_Biases")
    if biases is not None:
        found = [
            biases.number(tag) for tag in ("YAW", "PITCH", "ROLL") if biases.find(tag) is not None
        ]
        if np.any(found):
            notes.append("instrument biases other than 0 are stated and not applied")
    first_col = chosen.need("Swath_Range").number("FIRST_COL")
    last_col = chosen.need("Swath_Range").number("LAST_COL")
    if not last_col - first_col + 1 >= 1:
        raise ProductError(
            chosen.path, f"{chosen.place}/Swath_Range", "LAST_COL >= FIRST_COL expected"
        )
    if abs(last_col - first_col + 1 - samples) > 2:
        notes.append(
            f"the swath's columns {first_col:.0f} .. {last_col:.0f} are not as many as "
            f"the image's {samples}"
        )
    look = chosen.need("Polynomial_Look_Angles")
    x, y = _look_angle(look, "XLOS"), _look_angle(look, "YLOS")
    with blamed_on(look):
        directions = PolynomialDirections(y, -x, offset=1.0 - first_col)
        widest = np.max(np.abs(directions.tangents([0.0, samples - 1.0])))
    if not widest <= _MOST_TAN:
        raise ProductError(
            look.path, look.place, f"tangents below {_MOST_TAN} expected, they reach {widest:.3g}"
        )
    return directions


def _look_angle(look: XmlNode, name: str) -> FloatArray:
    """Coefficients `name`_0 (required), `name`_1, ... as far as they go."""
    values = [look.number(f"{name}_0")]
    if name == "XLOS":
        values.append(look.number("XLOS_1"))
    for degree in range(len(values), _MOST_LOOK_ANGLE_DEGREE + 1):
        if look.find(f"{name}_{degree}") is None:
            break
        values.append(look.number(f"{name}_{degree}"))
    return read_only(values)


def _sensor_name(root: XmlNode, profile: str) -> str:
    """Mission and index, as the source strip has them."""
    for strip in root.all("Dataset_Sources/Source_Identification/Strip_Source"):
        index = strip.find("MISSION_INDEX")
        if index is not None and profile == "PHR_SENSOR":
            return f"{_SENSORS[profile]}-{index.text()}"
    return _SENSORS[profile]
