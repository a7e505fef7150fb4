"""What DigitalGlobe support data say of one image, in one structure for both of their forms.

Each part comes from a group: IMD (image), EPH (ephemeris), ATT (attitude), GEO (camera), TIL
(files). In the text form each group is a file of its own.

Source: DigitalGlobe, Imagery Support Data (ISD) Documentation 1.1.2 (2014); the conventions were
checked against the RPCs of WorldView-1, -2, -3 and GeoEye-1 images.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.constants import WGS84_A_M
from geoposition.errors import UnsupportedError
from geoposition.sensors.readers.digitalglobe_image import ImageSupport
from geoposition.sensors.readers.digitalglobe_tree import Group
from geoposition.timescale import Epoch

_MAX_RATE_RAD_S = 0.2
"""Twice what the most agile of these satellites can do."""
_EPHEMERIS_COLUMNS = 13
_ATTITUDE_COLUMNS = 15


@dataclass(frozen=True, slots=True)
class Samples:
    """Group EPH or ATT: rows of `values` (n, k) at `times_s` (n,) from `epoch`."""

    group: Group
    list_name: str
    epoch: Epoch
    times_s: FloatArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class CameraSupport:
    """Group GEO: the camera, lengths in millimetres, the perspective centre in metres.

    Pixel s of the line array lies in the focal plane at `detector_origin_mm` + Rot(angle)
    (0, −`pitch_mm` s), before the principal distance; `quat_xyzw_body_camera` turns camera axes
    to body axes.
    """

    group: Group
    principal_distance_mm: float
    detector_origin_mm: tuple[float, float]
    detector_rotation_rad: float
    pitch_mm: float
    perspective_centre_body_m: tuple[float, float, float]
    quat_xyzw_body_camera: FloatArray
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Support:
    """All of it. Of the camera and its motion there is all or nothing."""

    path: Path
    image: ImageSupport
    ephemeris: Samples | None
    attitude: Samples | None
    camera: CameraSupport | None
    tiles: Group | None


def _samples(group: Group, list_name: str, columns: int) -> Samples:
    """Read a series; row k (1, 2, ...) belongs to STARTTIME + (k − 1) TIMEINTERVAL."""
    epoch, count = group.epoch("startTime"), group.integer("numPoints")
    interval = group.number("timeInterval")
    if not 1e-6 < interval < 1e4:
        raise group.error("timeInterval", f"a positive interval in seconds expected: {interval}")
    rows = group.table(list_name, columns)
    if len(rows) != count:
        raise group.error(
            list_name, f"{count} entries expected by {group.place_of('numPoints')}, got {len(rows)}"
        )
    if count < 2:
        raise group.error(list_name, f"at least 2 entries expected, got {count}")
    wrong = rows[:, 0] != np.arange(1, count + 1)
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise group.error(
            list_name, f"entries numbered 1, 2, 3, ... expected, entry {k + 1} has {rows[k, 0]:g}"
        )
    times_s: FloatArray = np.arange(count, dtype=np.float64) * interval
    return Samples(group, list_name, epoch, times_s, rows[:, 1:])


def parse_ephemeris(eph: Group) -> Samples:
    """Read EPH: ECEF position (3, m), ECEF velocity (3, m/s), position covariance (6, m2)."""
    samples = _samples(eph, "ephemList", _EPHEMERIS_COLUMNS)
    radius = np.linalg.norm(samples.values[:, :3], axis=1)
    outside = (radius < WGS84_A_M + 100e3) | (radius > 10 * WGS84_A_M)
    if np.any(outside):
        k = int(np.argmax(outside))
        raise eph.error(
            "ephemList",
            f"entry {k + 1}: orbit position in metres expected, radius {radius[k]:g}",
        )
    return samples


def parse_attitude(att: Group) -> Samples:
    """Read ATT: quaternion body to ECEF (4, scalar last), its covariance (10, upper triangle)."""
    samples = _samples(att, "attList", _ATTITUDE_COLUMNS)
    quats = samples.values[:, :4]
    norms = np.linalg.norm(quats, axis=1)
    bad = ~(np.abs(norms - 1.0) < 1e-3)
    if np.any(bad):
        k = int(np.argmax(bad))
        raise att.error(
            "attList", f"entry {k + 1}: a unit quaternion expected, norm {norms[k]:.6g}"
        )
    turn = (Rotation.from_quat(quats[:-1]).inv() * Rotation.from_quat(quats[1:])).magnitude()
    rate = turn / np.diff(samples.times_s)
    if np.max(rate) > _MAX_RATE_RAD_S:
        k = int(np.argmax(rate))
        raise att.error("attList", f"entries {k + 1} and {k + 2}: a turn by {rate[k]:.3g} rad/s")
    return samples


def parse_camera(geo: Group, band: str) -> CameraSupport:
    """Read GEO for `band`; where it holds others only, as for Multi, its first band."""
    level = geo.text("geoModelLevel")
    if not level.replace(" ", "").upper().endswith("1B"):
        raise UnsupportedError(
            geo.path,
            geo.place_of("geoModelLevel"),
            f"a level 1B camera expected, got {level!r}",
        )
    notes: list[str] = []
    distance = _length_mm(geo.need("PRINCIPAL_DISTANCE"), "PD", 100.0, 1e5)
    _refuse_distortion(geo.need("OPTICAL_DISTORTION"))
    centre_group = geo.need("PERSPECTIVE_CENTER")
    centre = (centre_group.number("cX"), centre_group.number("cY"), centre_group.number("cZ"))
    if any(centre):
        notes.append("perspective centre: taken as metres in the body frame")
    if max(abs(c) for c in centre) > 100.0:
        raise centre_group.error("cX", f"a lever arm in metres expected, got {centre}")
    mount = geo.need("CAMERA_ATTITUDE")
    quat = np.array([mount.number(f"qcs{i}") for i in (1, 2, 3, 4)])
    if not abs(float(np.linalg.norm(quat)) - 1.0) < 1e-3:
        raise mount.error("qcs1", f"a unit quaternion expected, norm {np.linalg.norm(quat):.6g}")
    array = _detector_array(geo.need("DETECTOR_MOUNTING"), band, notes)
    return CameraSupport(
        geo,
        distance,
        (array.number("detOriginX"), array.number("detOriginY")),
        array.number("detRotAngle"),
        _length_mm(array, "detPitch", 1e-4, 1.0),
        centre,
        quat,
        tuple(notes),
    )


def _length_mm(group: Group, name: str, low_mm: float, high_mm: float) -> float:
    value = group.number(name)
    if not low_mm <= value <= high_mm:
        raise group.error(name, f"a length of {low_mm:g} .. {high_mm:g} mm expected, got {value:g}")
    return value


def _refuse_distortion(distortion: Group) -> None:
    """Accept no distortion, or one whose coefficients vanish: the polynomial is not documented."""
    order = distortion.integer("polyOrder")
    if order < 0:
        return
    for name in ("aList", "bList"):
        if np.any(distortion.flat_list(name) != 0):
            raise UnsupportedError(
                distortion.path,
                distortion.place_of("polyOrder"),
                f"optical distortion of order {order} is not supported",
            )


def _detector_array(mounting: Group, band: str, notes: list[str]) -> Group:
    bands = [(name, group) for name, group in mounting.groups if name.startswith("BAND_")]
    if not bands:
        raise mounting.error("BAND_P", "a band with its detectors expected, there is none")
    named = dict(reversed(bands))
    name, group = f"BAND_{band.upper()}", named.get(f"BAND_{band.upper()}")
    if group is None:
        name, group = bands[0]
        notes.append(f"camera: of bands {', '.join(n for n, _ in bands)} the first was used")
    arrays = group.named("DETECTOR_ARRAY")
    if len(arrays) > 1:
        # Nothing tells which columns of the image each array fills.
        raise UnsupportedError(
            group.path, arrays[1].place, f"one detector array expected in {name}, got {len(arrays)}"
        )
    return group.need("DETECTOR_ARRAY")
