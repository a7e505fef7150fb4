"""Pleiades system metadata (DIMAP_PHR, PHR_SYSTEM_RECTIFIED_PRODUCT): the producer's own model.

Beside raw telemetry the file holds the model of the rectified image, an ideal push-broom camera:
ephemeris, quaternion polynomials, line period and viewing directions as polynomials of the
column. Its conventions are those of the DIMAP v2 product made from it: rows and columns count
from 1, quaternions (scalar first) turn the line-of-sight frame to WGS 84, the velocities are
inertial ones on Earth-fixed axes, aberration and refraction are contained.

*Source*: compared with the producer's direct location grid of the same image.
"""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from geoposition.corrections import NO_CORRECTIONS
from geoposition.errors import ProductError, UnsupportedError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.formats import read_rpc
from geoposition.sensors.directions import PolynomialDirections
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.readers.dimap_attitude import polynomial_attitude
from geoposition.sensors.readers.dimap_files import image_file
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

FORMAT: Final = "Pleiades system metadata (DIMAP_PHR)"
CANDIDATES: Final = ("PHRDIMAP*.XML", "phrdimap*.xml", "**/PHRDIMAP*.XML")

_ROOT: Final = "PHR_Dimap_Document"
_LEVEL: Final = "SENSOR"
_MOST_TAN: Final = 0.2


def recognises(source: Source) -> bool:
    """Whether `source` is Pleiades system metadata."""
    return source.xml_root == _ROOT


def read(source: Source) -> Product:
    """Read the model of a rectified Pleiades image from the producer's system metadata."""
    root = read_xml(source.path)
    level = root.need("Product_Characteristics/PROCESSING_LEVEL")
    if level.text() != _LEVEL:
        raise UnsupportedError(
            level.path, level.place, f"level {_LEVEL} expected, this is {level.text()!r}"
        )
    shape = image_shape(root.need("Raster_Dimensions"))
    sensor = root.need("Geometric_Data/Sensor_Model_Characteristics")
    epoch = epoch_at(sensor, "UTC_Sensor_Model_Range/START")
    period = line_period_s(sensor.need("SENSOR_LINE_PERIOD"), "ms")
    covered_s = epoch_at(sensor, "UTC_Sensor_Model_Range/END") - epoch
    if not 0.1 < shape[0] * period / max(covered_s, 1e-9) < 10.0:
        raise ProductError(
            sensor.path,
            f"{sensor.place}/SENSOR_LINE_PERIOD",
            f"lines over {covered_s:g} s expected (UTC_Sensor_Model_Range), "
            f"these take {shape[0] * period:g} s",
        )
    last = (shape[0] - 1) * period
    orbit = read_orbit(
        sensor.need("Sensor_Ephemeris/Point_List"),
        epoch,
        "LOCATION_VALUES",
        "VELOCITY_VALUES",
        "UTC_TIME",
    )
    attitude, notes = polynomial_attitude(_attitude_node(sensor), epoch, -period, last + period)
    directions = _directions(sensor.need("Sensor_Viewing_Model"), shape[1])
    rational = root.find("Geoposition/Rational_Sensor_Model/Global_RFM")
    rpc = None if rational is None else read_rpc(root.path)
    with blamed_on(sensor):
        camera = LineCamera.single(shape, ConstantLineRate(epoch, 0.0, period), directions)
        model = PushbroomModel(camera, orbit.ephemeris(), attitude, NO_CORRECTIONS, HEIGHT_RANGE_M)
    image_path, image_notes = image_file(
        root.all("Product_Characteristics/Product_Image_Characteristics/Data_Access/Data_File/"
                 "DATA_FILE_PATH"),
        root.path,
    )  # fmt: skip
    details: dict[str, object] = {
        "profile": root.text("Metadata_Identification/METADATA_PROFILE"),
        "corners": corners(root.all("Product_Frame/Dataset_Frame/Vertex")),
        "line_period_s": period,
        "velocities_in_file": orbit.velocity_kind,
        "notes": (*notes, *image_notes),
    }
    return Product(root.path, FORMAT, _sensor_name(root), model, rpc, image_path, epoch, details)


def _attitude_node(sensor: XmlNode) -> XmlNode:
    """Sensor_Attitudes with the polynomials as direct children, as DIMAP v2 has them."""
    attitudes = sensor.need("Sensor_Attitudes")
    models = attitudes.need("Polynomial_Models")
    merged = type(attitudes.element)("Polynomial_Models")
    merged.extend([*models.element, *attitudes.element])
    return XmlNode(attitudes.path, attitudes.place, merged)


def _directions(viewing: XmlNode, samples: int) -> PolynomialDirections:
    directions = viewing.need("Viewing_Directions")
    first_col = viewing.number("Position_In_Retina/FIRST_COL")
    psi = []
    for tag in ("PsiX_Model", "PsiY_Model"):
        node = directions.need(tag)
        coefficients = node.need("COEFFICIENTS").numbers()
        if len(coefficients) != node.integer("DEGREE") + 1:
            raise ProductError(
                node.path,
                f"{node.place}/COEFFICIENTS",
                f"{node.integer('DEGREE') + 1} numbers expected, got {len(coefficients)}",
            )
        psi.append(coefficients)
    with blamed_on(directions):
        result = PolynomialDirections(psi[1], -psi[0], offset=1.0 - first_col)
        widest = float(np.max(np.abs(result.tangents([0.0, samples - 1.0]))))
    if not widest <= _MOST_TAN:
        raise ProductError(
            directions.path,
            directions.place,
            f"tangents below {_MOST_TAN} expected, they reach {widest:.3g}",
        )
    return result


def _sensor_name(root: XmlNode) -> str:
    found = re.search(r"PHR(1[AB])", root.text("Dataset_Identification/DATASET_NAME"))
    return f"Pleiades-{found[1]}" if found else "Pleiades"
