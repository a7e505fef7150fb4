"""Curves of our model file: of positions, angles and quaternion components, and rotations."""

from __future__ import annotations

from typing import NoReturn

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from geoposition.arrays import FloatArray, read_only
from geoposition.attitude import (
    EulerCurve,
    ProductCurve,
    QuaternionCurve,
    RotationCurve,
    RotationSplineCurve,
    SlerpCurve,
    continuous_unit_quaternions,
)
from geoposition.errors import ArgumentError
from geoposition.interpolation import (
    Curve,
    LagrangeCurve,
    PolynomialCurve,
    SplineCurve,
    SumCurve,
)
from geoposition.sensors.readers.csm_interpolation import CsmLagrangeCurve
from geoposition.tomlfile import TomlNode

POSITION = ("x_m", "y_m", "z_m")
RATES = ("vx_m_s", "vy_m_s", "vz_m_s")
QUATERNION = ("q_x", "q_y", "q_z", "q_w")
ANGLES = ("a1_rad", "a2_rad", "a3_rad")

CURVES = ("lagrange", "lagrange-equal-steps", "spline", "hermite", "polynomial", "sum")
ROTATIONS = ("slerp", "rotation-spline", "components", "euler", "product")

_UNIT_ROUNDING = 1e-15
"""A quaternion as near to unit length was normalised already, and is kept to the last bit."""


def read_curve(node: TomlNode, columns: tuple[str, ...]) -> Curve:
    """Curve of `columns` that `node` describes."""
    kind = node.choice("kind", *CURVES)
    if kind == "sum":
        first, second = node.child("first"), node.child("second")
        total = SumCurve(read_curve(first, columns), read_curve(second, columns))
        first.finish()
        second.finish()
        if not total.span_s[0] < total.span_s[1]:
            node.refuse("first", "a time span in common with second expected")
        return total
    try:
        if kind == "lagrange":
            table = node.table("table", "t_s", *columns)
            points = node.whole("points", 2, 64) if node.has("points") else 8
            return LagrangeCurve(table[:, 0], table[:, 1:], points)
        if kind == "lagrange-equal-steps":
            order = node.whole("order", 4, 8) if node.has("order") else 8
            start_s, step_s = node.number("start_s"), node.number("step_s")
            return CsmLagrangeCurve(start_s, step_s, node.table("table", *columns), order)
        if kind == "spline":
            table = node.table("table", "t_s", *columns)
            return SplineCurve.through(table[:, 0], table[:, 1:])
        if kind == "hermite":
            rates = RATES if columns == POSITION else tuple(f"rate_{name}" for name in columns)
            table = node.table("table", "t_s", *columns, *rates)
            k = len(columns) + 1
            return SplineCurve.hermite(table[:, 0], table[:, 1:k], table[:, k:])
        span = node.numbers("span_s", 2)
        if not span[0] < span[1]:
            node.refuse("span_s", "first and last time, increasing, expected")
        return PolynomialCurve(
            node.table("table", *columns),
            node.number("offset_s"),
            node.number("scale_s"),
            (float(span[0]), float(span[1])),
        )
    except ArgumentError as error:
        _refuse(node, error)


def read_rotations(node: TomlNode) -> RotationCurve:
    """Rotation over time that `node` describes."""
    kind = node.choice("kind", *ROTATIONS)
    if kind == "product":
        outer, inner = node.child("outer"), node.child("inner")
        product = ProductCurve(read_rotations(outer), read_rotations(inner))
        outer.finish()
        inner.finish()
        if not product.span_s[0] < product.span_s[1]:
            node.refuse("outer", "a time span in common with inner expected")
        return product
    try:
        if kind in ("slerp", "rotation-spline"):
            return _through(kind, node.table("table", "t_s", *QUATERNION, rows=2))
        curve_node = node.child("curve")
        if kind == "euler":
            sequence = node.text("sequence")
            try:
                Rotation.from_euler(sequence, [0.0, 0.0, 0.0])
            except ValueError:
                sequence = ""
            if sequence != sequence.upper() or len(sequence) != 3:
                node.refuse("sequence", "three of X, Y, Z such as ZXY expected")
            curve = read_curve(curve_node, ANGLES)
            curve_node.finish()
            return EulerCurve(curve, sequence)
        curve = read_curve(curve_node, QUATERNION)
        curve_node.finish()
        norms = np.linalg.norm(curve.value(np.linspace(*curve.span_s, 64)), axis=-1)
        if np.any(np.abs(norms - 1.0) > 0.1):
            node.refuse("curve", "quaternions of about unit length expected")
        return QuaternionCurve(curve)
    except ArgumentError as error:
        _refuse(node, error)


def _through(kind: str, table: FloatArray) -> RotationCurve:
    """Interpolate rows of time and quaternion; those of unit length keep their last bits."""
    times, quats = table[:, 0], table[:, 1:]
    continuous = continuous_unit_quaternions(times, quats)
    rounded = np.abs(np.sum(quats * quats, axis=1) - 1.0) <= _UNIT_ROUNDING
    signs = np.sign(np.sum(continuous * quats, axis=1))[:, None]
    exact = np.where(rounded[:, None], signs * quats, continuous)
    rotations = Rotation(exact, normalize=False)
    if kind == "slerp":
        return SlerpCurve(read_only(times), Slerp(read_only(times), rotations))
    return RotationSplineCurve(read_only(times), RotationSpline(read_only(times), rotations))


def read_rotation(node: TomlNode, key: str) -> Rotation:
    """One rotation from a quaternion, scalar last; unit ones keep their last bits."""
    quat = node.numbers(key, 4)
    norm = float(np.sum(quat * quat))
    if abs(norm - 1.0) > 2e-3:
        node.refuse(key, f"a quaternion of unit length expected, this has {np.sqrt(norm):.6g}")
    return Rotation(quat, normalize=abs(norm - 1.0) > _UNIT_ROUNDING)


def _refuse(node: TomlNode, error: ArgumentError) -> NoReturn:
    """Name the table, if there is one, where a curve's samples are at fault."""
    node.refuse("table" if node.has("table") else "kind", str(error))
