"""DIMAP v1 scenes and segments at level 1A: SPOT 1-5 (HRV, HRVIR, HRG, HRS).

Each detector has its look angles, the satellite its yaw, pitch and roll about orbital axes built
from the ephemeris. Rows, columns and detectors count from 1 in the file. No aberration and no
refraction are modelled: the maker's own locations, the tie points, have none.

*Source*: SPOT Satellite Geometry Handbook (S-NT-73-12-SI, 2002), section 4; the conventions were
checked against the tie points that come with the products.
"""

from __future__ import annotations

import re
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, read_only
from geoposition.attitude import Attitude
from geoposition.corrections import NO_CORRECTIONS
from geoposition.ellipsoid import geodetic_to_ecef
from geoposition.errors import ProductError, UnsupportedError
from geoposition.flags import has_result
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.directions import Directions, PolynomialDirections, TableDirections
from geoposition.sensors.line_camera import LineCamera, Mounting
from geoposition.sensors.readers.dimap_attitude import angle_attitude
from geoposition.sensors.readers.dimap_files import image_file
from geoposition.sensors.readers.dimap_orbit import Orbit, read_orbit
from geoposition.sensors.readers.dimap_xml import (
    HEIGHT_RANGE_M,
    MAX_SIZE_PX,
    blamed_on,
    corners,
    epoch_at,
    image_shape,
    line_period_s,
)
from geoposition.sensors.readers.source import Source
from geoposition.sensors.timing import ConstantLineRate
from geoposition.xmlfile import XmlNode, read_xml

FORMAT: Final = "DIMAP v1 (SPOT 1-5)"
CANDIDATES: Final = (
    "METADATA.DIM",
    "metadata.dim",
    "**/METADATA.DIM",
    "**/metadata.dim",
    "*.DIM",
    "*.dim",
    "*.xml",
    "*.XML",
)  # fmt: skip

_R_BODY_CAMERA: Final = (1.0, 0.0, 0.0, 0.0)
"""Quaternion xyzw, half a turn about x: the camera's optical axis looks down, the body's z up."""
_MOST_ANGLE_RAD: Final = 1.2
_LEVEL: Final = "1A"
_IMAGE_SUFFIXES: Final = (".tif", ".tiff", ".jp2")


def recognises(source: Source) -> bool:
    """Whether `source` is DIMAP v1 metadata of an image, not of a volume."""
    if source.xml_root != "Dimap_Document" or re.search(
        rb"METADATA_PROFILE[^>]*>\s*VOLUME", source.head
    ):
        return False
    return re.search(rb"<\s*(\w+:)?Metadata_Id\s*>", source.head) is not None


def read(source: Source) -> Product:
    """Read a SPOT 1-5 scene or segment of level 1A."""
    root = read_xml(source.path)
    scene = _require_level_1a(root)
    notes: list[str] = []
    strip = root.need("Data_Strip")
    rows, cols = image_shape(root.need("Raster_Dimensions"))
    stamp = strip.need("Sensor_Configuration/Time_Stamp")
    epoch = epoch_at(stamp, "SCENE_CENTER_TIME")
    period = line_period_s(stamp.need("LINE_PERIOD"), "s")
    first_s = (1.0 - stamp.number("SCENE_CENTER_LINE")) * period
    last_s = first_s + (rows - 1) * period
    orbit = read_orbit(strip.need("Ephemeris/Points"), epoch, "Location", "Velocity", "TIME")
    if first_s > orbit.times_s[-1] or last_s < orbit.times_s[0]:
        node = strip.need("Ephemeris/Points")
        raise ProductError(node.path, node.place, "points around the time of the image expected")
    attitude, attitude_notes = _attitude(strip, orbit, first_s - period, last_s + period)
    notes += attitude_notes
    timing = ConstantLineRate(epoch, first_s, period)
    ties = _tie_points(root)
    bands = strip.some("Sensor_Configuration/Instrument_Look_Angles_List/Instrument_Look_Angles")
    models: list[tuple[float, XmlNode, PushbroomModel, list[str]]] = []
    for band in bands:
        directions, samples, band_notes = _directions(band, cols)
        with blamed_on(strip):
            camera = LineCamera.single(
                (rows, samples), timing, directions, Mounting(Rotation.from_quat(_R_BODY_CAMERA))
            )
            model = PushbroomModel(
                camera, orbit.ephemeris(), attitude, NO_CORRECTIONS, HEIGHT_RANGE_M
            )
        models.append((_tie_distance_m(model, ties), band, model, band_notes))
    distance, band, model, band_notes = min(models, key=lambda entry: entry[0])
    notes += band_notes
    if len(models) > 1:
        notes.append(
            f"look angles of band {_band(band)}, the one of {len(models)} nearest to the tie points"
        )
    details: dict[str, object] = {
        "profile": root.text("Metadata_Id/METADATA_PROFILE"),
        "corners": corners(root.all("Dataset_Frame/Vertex"), "FRAME_"),
        "tie_points": len(ties),
        "line_period_s": period,
        "velocities_in_file": orbit.velocity_kind,
    }
    if np.isfinite(distance):
        details["tie_points_farthest_m"] = distance
    image_path, image_notes = image_file(
        root.all("Data_Access/Data_File/DATA_FILE_PATH"), root.path
    )
    if image_path is not None and image_path.suffix.lower() not in _IMAGE_SUFFIXES:
        image_path = root.path  # raw samples: GDAL reads them through the metadata
    details["notes"] = tuple(notes + image_notes)
    sensor = " ".join(
        f"{scene.text(tag)}{scene.text(tag + '_INDEX')}" for tag in ("MISSION", "INSTRUMENT")
    )
    return Product(root.path, FORMAT, sensor, model, None, image_path, epoch + first_s, details)


def _require_level_1a(root: XmlNode) -> XmlNode:
    """Refuse other missions and resampled levels; return the Scene_Source."""
    level = root.need("Data_Processing/PROCESSING_LEVEL")
    if level.text() != _LEVEL:
        raise UnsupportedError(
            level.path,
            level.place,
            f"level {_LEVEL} expected: level {level.text()!r} is resampled and has no sensor model",
        )
    scene = root.need("Dataset_Sources/Source_Information/Scene_Source")
    mission = scene.need("MISSION")
    if mission.text().upper() != "SPOT" or scene.text("MISSION_INDEX") not in set("12345"):
        raise UnsupportedError(
            mission.path,
            mission.place,
            f"SPOT 1 .. 5 expected, this is {mission.text()} {scene.text('MISSION_INDEX')}",
        )
    for region in root.all("Data_Processing/Regions_Of_Interest/Region_Of_Interest"):
        for tag in ("ROW_MIN", "COL_MIN"):
            if region.find(tag) is not None and region.integer(tag) != 1:
                raise UnsupportedError(
                    region.path, f"{region.place}/{tag}", "1 expected: crops are not supported"
                )
    return scene


def _attitude(
    strip: XmlNode, orbit: Orbit, first_s: float, last_s: float
) -> tuple[Attitude, list[str]]:
    """Corrected attitudes (SPOT 5 with star tracker), else the raw ones, with notes."""
    attitudes = strip.need("Satellite_Attitudes")
    corrected = attitudes.find("Corrected_Attitudes/Corrected_Attitude")
    notes = []
    if corrected is not None:
        parent, samples = corrected, corrected.all("Angles")
    else:
        parent = attitudes.need("Raw_Attitudes/Aocs_Attitude/Angles_List")
        samples = parent.all("Angles")
        notes.append("raw attitudes: the product has no corrected ones")
    parent.some("Angles")
    used = [node for node in samples if not _out_of_range(node)]
    if len(used) < len(samples):
        notes.append(f"{len(samples) - len(used)} attitude samples out of range, not used")
    attitude, more = angle_attitude(used, parent, orbit, first_s, last_s)
    return attitude, notes + more


def _out_of_range(sample: XmlNode) -> bool:
    mark = sample.find("OUT_OF_RANGE")
    return mark is not None and mark.text().upper() != "N"


def _directions(band: XmlNode, cols: int) -> tuple[Directions, int, list[str]]:
    """Look angles of the columns, the number of columns they serve, and notes.

    Two entries (SPOT 1-4) stand for angles that grow evenly along the whole row; a longer table
    that ends before the row does serves the columns it has.
    """
    parent = band.need("Look_Angles_List")
    entries = parent.some("Look_Angles")
    if len(entries) < 2:
        raise ProductError(parent.path, parent.place, "2 or more detectors expected")
    ids = np.array([entry.integer("DETECTOR_ID") for entry in entries])
    rows = [[entry.number("PSI_Y"), entry.number("PSI_X")] for entry in entries]
    psi = np.array(rows)
    if np.max(np.abs(psi)) > _MOST_ANGLE_RAD:
        place = entries[int(np.argmax(np.abs(psi).max(axis=1)))].place
        raise ProductError(parent.path, place, "look angles in radians, off nadir, expected")
    wrong = np.append(ids[0] != 1, np.diff(ids) <= 0)
    if np.any(wrong) or ids[-1] > MAX_SIZE_PX:
        place = entries[int(np.argmax(wrong))].place
        raise ProductError(parent.path, place, "detectors in increasing order from 1 on expected")
    last = int(ids[-1])
    if len(entries) == 2:
        if not 0.5 * cols < last < 2.0 * cols:
            raise ProductError(
                parent.path,
                entries[-1].place,
                f"the detector of column {cols} expected, got {last}",
            )
        step = (psi[1] - psi[0]) / (last - 1)
        even = PolynomialDirections(
            read_only([-psi[0, 0], -step[0]]), read_only([-psi[0, 1], -step[1]]), angles=True
        )
        return even, cols, _column_notes(last, cols)
    # Entries may be missing: it is the angles that are linear, not their tangents.
    detectors = np.arange(1, last + 1)
    table = np.stack([np.interp(detectors, ids, psi[:, k]) for k in range(2)], axis=-1)
    with blamed_on(parent):
        directions = TableDirections(read_only(detectors - 1.0), read_only(-np.tan(table)))
    return directions, min(last, cols), _column_notes(last, cols)


def _column_notes(last: int, cols: int) -> list[str]:
    if last < cols:
        return [f"look angles end at column {last} of {cols}"]
    if last > cols:
        return [f"look angles for {last} detectors, the image has {cols} columns"]
    return []


def _band(band: XmlNode) -> str:
    index = band.find("BAND_INDEX")
    return "without number" if index is None else index.text()


def _tie_points(root: XmlNode) -> FloatArray:
    """Maker's tie points (n, 5): row, col (0-based), lon_rad, lat_rad, height_m; may be none."""
    tags = ("DATA_Y", "DATA_X", "CRS_X", "CRS_Y", "CRS_Z")
    rows = []
    for node in root.all("Geoposition/Geoposition_Points/Tie_Point"):
        if all(node.find(f"TIE_POINT_{tag}") is not None for tag in tags):
            rows.append([node.number(f"TIE_POINT_{tag}") for tag in tags])
    ties = np.array(rows).reshape(-1, 5) - np.array([1.0, 1.0, 0.0, 0.0, 0.0])
    ties[:, 2:4] = np.radians(ties[:, 2:4])
    return read_only(ties)


def _tie_distance_m(model: PushbroomModel, ties: FloatArray) -> float:
    """Largest distance of the model from the tie points it can locate; infinite without any."""
    located = model.image_to_ground(ties[:, :2], ties[:, 4])
    seen = has_result(located.flag)
    if not np.any(seen):
        return np.inf
    misses = geodetic_to_ecef(located.geodetic[seen]) - geodetic_to_ecef(ties[seen, 2:])
    return float(np.max(np.linalg.norm(misses, axis=-1)))
