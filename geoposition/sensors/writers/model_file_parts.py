"""Sections and tables of our model file, from the nouns; the schema is the reader's docstring."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from geoposition.arrays import FloatArray
from geoposition.attitude import (
    EulerCurve,
    ProductCurve,
    QuaternionCurve,
    RotationCurve,
    RotationSplineCurve,
    SlerpCurve,
)
from geoposition.errors import GeometryError
from geoposition.interpolation import (
    Curve,
    LagrangeCurve,
    PolynomialCurve,
    SplineCurve,
    SumCurve,
)
from geoposition.sensors.readers.csm_interpolation import CsmLagrangeCurve
from geoposition.sensors.readers.model_file_curves import ANGLES, POSITION, QUATERNION, RATES
from geoposition.timescale import Epoch

Value = str | float | int | bool | list[float] | dict[str, "Value"]
Section = dict[str, Value]

DENSE_TOLERANCE_RAD = 1e-10
DENSE_TOLERANCE_M = 1e-6
_DENSE_CELLS = (64, 2**19)


@dataclass(slots=True)
class Tables:
    """CSV tables to write: name of the file to header and rows."""

    stem: str
    files: dict[str, tuple[tuple[str, ...], FloatArray]] = field(default_factory=dict)

    def add(self, part: str, columns: tuple[str, ...], *parts: FloatArray) -> str:
        """File name under which the columns, arrays (n,) or (n, k), will be written."""
        name = f"{self.stem}_{part}.csv"
        rows = np.column_stack(parts)
        assert rows.shape[1] == len(columns)
        assert name not in self.files
        self.files[name] = (columns, rows)
        return name


def csv_text(columns: tuple[str, ...], rows: FloatArray) -> str:
    """CSV of `rows` under the header `columns`, each number to the last bit."""
    lines = [",".join(map(repr, row)) for row in rows.tolist()]
    return "\n".join([",".join(columns), *lines]) + "\n"


def epoch_section(epoch: Epoch) -> Section:
    """Epoch, exact to the last bit."""
    return {"epoch_tai_s": epoch.tai_s, "epoch_fraction": epoch.fraction}


def curve_section(curve: Curve, columns: tuple[str, ...], part: str, tables: Tables) -> Section:
    """Section of `curve`; one of an unknown kind becomes a dense Lagrange table."""
    if isinstance(curve, LagrangeCurve):
        name = tables.add(part, ("t_s", *columns), curve.times_s, curve.values)
        return {"kind": "lagrange", "points": curve.points, "table": name}
    if isinstance(curve, CsmLagrangeCurve):
        return {
            "kind": "lagrange-equal-steps",
            "start_s": curve.start_s,
            "step_s": curve.step_s,
            "order": curve.order,
            "table": tables.add(part, columns, curve.values),
        }
    if isinstance(curve, PolynomialCurve):
        return {
            "kind": "polynomial",
            "offset_s": curve.offset_s,
            "scale_s": curve.scale_s,
            "span_s": [*curve.span_s],
            "table": tables.add(part, columns, curve.coefficients),
        }
    if isinstance(curve, SplineCurve):
        if isinstance(curve.spline, CubicSpline):
            again = SplineCurve.through(curve.times_s, curve.values)
            if np.array_equal(again.spline.c, curve.spline.c):
                name = tables.add(part, ("t_s", *columns), curve.times_s, curve.values)
                return {"kind": "spline", "table": name}
        rates = RATES if columns == POSITION else tuple(f"rate_{name}" for name in columns)
        slopes = hermite_slopes(curve.spline, curve.values)
        name = tables.add(part, ("t_s", *columns, *rates), curve.times_s, curve.values, slopes)
        return {"kind": "hermite", "table": name}
    if isinstance(curve, SumCurve):
        first = curve_section(curve.first, columns, f"{part}_first", tables)
        second = curve_section(curve.second, columns, f"{part}_second", tables)
        return {"kind": "sum", "first": dict(first), "second": dict(second)}
    return _dense_curve(curve, columns, part, tables)


def _dense_curve(curve: Curve, columns: tuple[str, ...], part: str, tables: Tables) -> Section:
    tolerance = DENSE_TOLERANCE_M if columns == POSITION else 0.3 * DENSE_TOLERANCE_RAD
    cells, most = _DENSE_CELLS
    while cells <= most:
        times = np.linspace(*curve.span_s, cells + 1)
        dense = LagrangeCurve(times, curve.value(times), 8)
        check = 0.5 * (times[1:] + times[:-1])
        if np.max(np.abs(dense.value(check) - curve.value(check))) <= tolerance:
            return curve_section(dense, columns, part, tables)
        cells *= 2
    raise GeometryError("model file: a curve is too rough to tabulate")


def rotation_section(curve: RotationCurve, part: str, tables: Tables) -> Section:
    """Section of `curve`; one of an unknown kind becomes a dense table, its error beside it."""
    if isinstance(curve, SlerpCurve):
        quats = slerp_quaternions(curve)
        name = tables.add(part, ("t_s", *QUATERNION), curve.times_s, quats)
        return {"kind": "slerp", "table": name}
    if isinstance(curve, RotationSplineCurve):
        quats = curve.interpolant.rotations.as_quat()
        name = tables.add(part, ("t_s", *QUATERNION), curve.times_s, quats)
        return {"kind": "rotation-spline", "table": name}
    if isinstance(curve, QuaternionCurve):
        components = curve_section(curve.components_xyzw, QUATERNION, part, tables)
        return {"kind": "components", "curve": dict(components)}
    if isinstance(curve, EulerCurve):
        angles = curve_section(curve.angles_rad, ANGLES, part, tables)
        return {"kind": "euler", "sequence": curve.sequence, "curve": dict(angles)}
    if isinstance(curve, ProductCurve):
        outer = rotation_section(curve.outer, f"{part}_outer", tables)
        inner = rotation_section(curve.inner, f"{part}_inner", tables)
        errors = [float(s.pop("tabulated_error_rad", 0.0)) for s in (outer, inner)]  # type: ignore[arg-type]
        section: Section = {"kind": "product", "outer": dict(outer), "inner": dict(inner)}
        return section | ({"tabulated_error_rad": sum(errors)} if any(errors) else {})
    return _dense_rotation(curve, part, tables)


def _dense_rotation(curve: RotationCurve, part: str, tables: Tables) -> Section:
    cells, most = _DENSE_CELLS
    while cells <= most:
        times = np.linspace(*curve.span_s, cells + 1)
        dense = QuaternionCurve.lagrange(times, curve.rotation(times).as_quat())
        # Thirds and halves: a kink that lies on one is off the other.
        check = (times[:-1, None] + np.diff(times)[:, None] * np.array([1 / 3, 1 / 2])).ravel()
        error = float(np.max((dense.rotation(check).inv() * curve.rotation(check)).magnitude()))
        if error <= DENSE_TOLERANCE_RAD:
            section = rotation_section(dense, part, tables)
            return section | {"tabulated_error_rad": error}
        cells *= 2
    raise GeometryError("model file: the attitude is too rough to tabulate to 1e-10 rad")


def slerp_quaternions(curve: SlerpCurve) -> FloatArray:
    """Quaternions (n, 4) that make `curve` again, to the last bit where that can be found.

    SciPy's slerp keeps all but the last rotation, and the turn to it: the last is the neighbour
    of the end's value, within rounding, that gives the same turn.
    """
    slerp: Slerp = curve.interpolant
    known = slerp.rotations.as_quat()
    end = slerp(curve.times_s[-1:]).as_quat()[0]
    steps = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 4, indexing="ij"), axis=-1).reshape(-1, 4)
    candidates = end + steps * np.spacing(np.abs(end))
    near_one = np.abs(np.sum(candidates**2, axis=1) - 1.0) <= 5e-16
    last = slerp.rotations[-1].inv()
    turns = (last * Rotation(candidates, normalize=False)).as_rotvec()
    off = np.max(np.abs(turns - slerp.rotvecs[-1]), axis=1) + ~near_one
    return np.concatenate([known, candidates[np.argmin(off)][None]])


def hermite_slopes(spline: CubicHermiteSpline, values: FloatArray) -> FloatArray:
    """First derivatives (n, k) that make `spline` again, to the last bit where that can be found.

    The polynomials keep all but the last slope as it is: it is sought among the neighbours.
    """
    last = spline(spline.x[-1:], 1)[0]
    steps = np.arange(-64, 65)[:, None] * np.spacing(np.abs(last))
    slopes = np.stack([np.broadcast_to(spline.c[2, -1], steps.shape), last + steps])
    ends = np.broadcast_to(values[-2:, None], slopes.shape)
    c = CubicHermiteSpline(spline.x[-2:], ends, slopes, axis=0).c[:2, 0]
    off = np.max(np.abs(c - spline.c[:2, -1][:, None]), axis=0)
    best = np.argmin(off, axis=0)
    chosen = slopes[1, best, np.arange(len(last))]
    return np.concatenate([spline.c[2], chosen[None]])


def toml(section: Mapping[str, Value], prefix: str = "") -> str:
    """TOML of a section: plain keys first, then its tables."""
    plain = [f"{key} = {_toml(v)}" for key, v in section.items() if not isinstance(v, dict)]
    text = "\n".join(plain) + "\n"
    for key, value in section.items():
        if isinstance(value, dict):
            text += f"\n[{prefix}{key}]\n" + toml(value, f"{prefix}{key}.")
    return text


def _toml(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + "".join(_escaped(c) for c in value) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    assert isinstance(value, int | float)
    return repr(float(value)) if isinstance(value, float) else repr(int(value))


def _escaped(character: str) -> str:
    if character in '"\\':
        return f"\\{character}"
    if ord(character) < 32 or ord(character) == 127:
        return f"\\u{ord(character):04x}"
    return character
