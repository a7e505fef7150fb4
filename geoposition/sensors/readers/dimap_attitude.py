"""Attitude of Airbus and CNES products: quaternion polynomials, quaternion lists, SPOT angles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import (
    Attitude,
    EulerCurve,
    ProductCurve,
    QuaternionCurve,
    SlerpCurve,
    continuous_unit_quaternions,
)
from geoposition.errors import ProductError
from geoposition.interpolation import LagrangeCurve, PolynomialCurve
from geoposition.sensors.readers.dimap_orbit import Orbit, OrbitAxesCurve
from geoposition.sensors.readers.dimap_xml import blamed_on, epoch_at
from geoposition.timescale import Epoch
from geoposition.xmlfile import XmlNode

_NORM_TOLERANCE: Final = 1e-2
_MOST_NORMALISED_TIME: Final = 1.5
"""Quaternion polynomials are fitted over -1 .. 1; further out they are not to be believed."""
_DAY_S: Final = 86400.0
_MOST_PROLONGED_STEPS: Final = 2.0
_MOST_ANGLE_RAD: Final = 1.0


def polynomial_attitude(
    model: XmlNode, epoch: Epoch, first_s: float, last_s: float
) -> tuple[Attitude, list[str]]:
    """Attitude from polynomials Q0 .. Q3 under `model`, and notes on what was assumed.

    The image lasts from `first_s` to `last_s` after `epoch`. Q0 is the scalar; the argument is
    (seconds of the UTC day - OFFSET) / SCALE, coefficients ascend. The polynomials turn the
    line-of-sight frame to the Earth-fixed one.
    """
    columns = [_coefficients(model.need(f"Q{i}")) for i in (1, 2, 3, 0)]
    table = np.zeros((max(len(column) for column in columns), 4))
    for i, column in enumerate(columns):
        table[: len(column), i] = column
    scale = model.number("SCALE")
    if scale <= 0:
        raise ProductError(model.path, f"{model.place}/SCALE", f"above 0 expected, got {scale:g}")
    middle = 0.5 * (first_s + last_s)
    midnight = Epoch.from_utc(epoch.utc_iso(0)[:10] + "T00:00:00") - epoch
    # A scene just after midnight may count from the day before: take the nearest day.
    days = midnight + model.number("OFFSET") + np.array([-1.0, 0.0, 1.0]) * _DAY_S
    offset = float(days[np.argmin(np.abs(days - middle))])
    low, high = offset - scale, offset + scale
    notes = []
    if first_s < low or last_s > high:
        reach = _MOST_NORMALISED_TIME * scale
        low, high = max(first_s, offset - reach), min(last_s, offset + reach)
        low, high = min(low, offset - scale), max(high, offset + scale)
        if last_s < low or first_s > high:
            raise ProductError(
                model.path,
                f"{model.place}/OFFSET",
                f"a time near the image's expected, it is {abs(offset - middle):.1f} s away",
            )
        notes.append("the quaternion polynomials are used beyond the interval they were fitted to")
    with blamed_on(model):
        curve = QuaternionCurve(PolynomialCurve(table, offset, scale, (low, high)))
        at = np.clip(np.array([first_s, middle, last_s]), low, high)
        norms = np.linalg.norm(curve.components_xyzw.value(at), axis=-1)
    if not np.all(np.abs(norms - 1.0) <= _NORM_TOLERANCE):
        worst = norms[np.argmax(np.abs(norms - 1.0))]
        raise ProductError(
            model.path, model.place, f"unit quaternions expected, their norm is {worst:.4g}"
        )
    return Attitude(epoch, curve), notes


def _coefficients(node: XmlNode) -> FloatArray:
    coefficients = node.need("COEFFICIENTS").numbers()
    if node.find("DEGREE") is not None and len(coefficients) != node.integer("DEGREE") + 1:
        raise ProductError(
            node.path,
            f"{node.place}/COEFFICIENTS",
            f"{node.integer('DEGREE') + 1} numbers expected for the DEGREE stated, "
            f"got {len(coefficients)}",
        )
    return coefficients


def quaternion_list_attitude(
    quaternions: XmlNode, epoch: Epoch, first_s: float, last_s: float, most_s: float
) -> Attitude:
    """Attitude through the elements Quaternion under `quaternions`: Q0 (scalar) .. Q3, TIME.

    Spherical linear interpolation. Where the list misses `first_s` or `last_s` by no more than
    `most_s`, it goes on at the rate it ends with.
    """
    nodes = quaternions.some("Quaternion")
    times = np.array([epoch_at(node, "TIME") - epoch for node in nodes])
    table = np.array([[node.number(f"Q{i}") for i in (1, 2, 3, 0)] for node in nodes])
    if len(nodes) < 2:
        raise ProductError(quaternions.path, quaternions.place, "2 or more quaternions expected")
    with blamed_on(quaternions):
        table = continuous_unit_quaternions(times, table)
        if 0 < times[0] - first_s <= most_s:
            times, table = np.insert(times, 0, first_s), _beyond(times, table, first_s)
        if 0 < last_s - times[-1] <= most_s:
            turned = _beyond(times[::-1], table[::-1], last_s)[::-1]
            times, table = np.append(times, last_s), turned
        return Attitude(epoch, SlerpCurve.through(times, table))


def _beyond(times_s: FloatArray, quat_xyzw: FloatArray, at_s: float) -> FloatArray:
    """Put one more in front of the list, at `at_s`, along the turn of its first two."""
    first, second = Rotation.from_quat(quat_xyzw[0]), Rotation.from_quat(quat_xyzw[1])
    part = (at_s - times_s[0]) / (times_s[1] - times_s[0])
    added = first * Rotation.from_rotvec(part * (first.inv() * second).as_rotvec())
    return np.concatenate([added.as_quat()[None], quat_xyzw])


def angle_attitude(
    samples: Sequence[XmlNode], parent: XmlNode, orbit: Orbit, first_s: float, last_s: float
) -> tuple[Attitude, list[str]]:
    """SPOT 1-5 attitude from YAW, PITCH, ROLL (rad) at TIME about the orbital axes, and notes.

    The angles are linear between the `samples`; up to two steps beyond them they go on as they
    end. R_orbit_body = Mp Mr My = Rx(-pitch) Ry(-roll) Rz(yaw).

    *Source*: SPOT Satellite Geometry Handbook (S-NT-73-12-SI, 2002), section 4.
    """
    times = np.array([epoch_at(node, "TIME") - orbit.epoch for node in samples])
    signs = {"PITCH": -1.0, "ROLL": -1.0, "YAW": 1.0}
    rows = [[sign * node.number(tag) for tag, sign in signs.items()] for node in samples]
    angles = np.array(rows).reshape(-1, 3)
    if len(times) < 2:
        raise ProductError(parent.path, parent.place, "2 or more attitude samples expected")
    wild = np.abs(angles) > _MOST_ANGLE_RAD
    if np.any(wild):
        place = samples[int(np.argmax(wild.any(axis=1)))].place
        raise ProductError(parent.path, place, "small angles in radians expected")
    notes = []
    with blamed_on(parent):
        LagrangeCurve(times, angles, 2)  # refuses unsorted and repeated times
        low, high = times[0], times[-1]
        times, angles = _prolonged(times, angles, first_s, last_s)
        if (low, high) != (times[0], times[-1]):
            notes.append(
                f"attitude prolonged by {low - times[0]:.3f} s before its first "
                f"and {times[-1] - high:.3f} s after its last sample"
            )
        axes = OrbitAxesCurve(orbit.positions, orbit.velocities)
        curve = ProductCurve(axes, EulerCurve(LagrangeCurve(times, angles, 2), "XYZ"))
        return Attitude(orbit.epoch, curve), notes


def _prolonged(
    times_s: FloatArray, values: FloatArray, first_s: float, last_s: float
) -> tuple[FloatArray, FloatArray]:
    for at_s, (end, inner, index) in ((first_s, (0, 1, 0)), (last_s, (-1, -2, len(times_s)))):
        step = times_s[end] - times_s[inner]
        part = (at_s - times_s[end]) / step
        if part <= 0:
            continue
        part = min(part, _MOST_PROLONGED_STEPS)
        added = values[end] + part * (values[end] - values[inner])
        index = index if index == 0 else len(times_s)
        times_s = np.insert(times_s, index, times_s[end] + part * step)
        values = np.insert(values, index, added, axis=0)
    return times_s, values
