"""The toolkit's own model file: a TOML text and CSV tables beside it.

It describes a rigorous push-broom model completely. Every key below is read; one that is not
listed is refused, as misspelt. Tables are CSV files with exactly the header given here; they are
named relative to the TOML file and must lie in its folder or below. Times are seconds from the
`epoch` of their section, which is `epoch_utc = "2020-01-31T12:00:00Z"`, or, exact to the last
bit, `epoch_tai_s` (whole seconds since 2000-01-01T00:00:00 TAI) and `epoch_fraction`. Lines and
samples count from 0 at the first pixel's centre. Lengths are metres, angles radians.
Quaternions have the scalar last. ::

    format = "geoposition model"
    version = 1
    sensor = "for people"              # optional
    image = "scene.tif"                # optional: the image this is the model of
    lines = 20000
    height_range_m = [0.0, 3000.0]     # ellipsoidal heights the model is meant for
    # camera = "camera.toml":          a camera file, in place of [mounting] and [[ccd]]

    [timing]
    epoch_utc = "2020-01-31T12:00:00Z"
    kind = "rate"                      # or "table"
    first_line_s = 10.5                # rate: time of line 0 and of each line,
    line_period_s = 1e-4               #   negative in reverse scans
    table = "lines.csv"                # table: line,t_s; linear in between and beyond

    [mounting]                         # optional: camera = body without it
    R_body_camera_xyzw = [0, 0, 0, 1]  # takes camera to body
    lever_arm_body_m = [0, 0, 0]       # perspective centre from the ephemeris's point

    [[ccd]]                            # one or more, side by side in the image row
    samples = 30000
    kind = "polynomial"                # tangents x, y: the direction is along (x, y, 1)
    x = [0.0, 1e-7]                    #   ascending in s = (sample - offset) / scale
    y = [0.01]
    offset = 0.0                       #   optional
    scale = 1.0                        #   optional
    angles = false                     #   optional: x, y are angles, not tangents
    # kind = "table" or "spline":      table = "ccd.csv" with sample,x,y
    # kind = "collinear":              focal_length, detector_origin = [x, y], pitch = [x, y],
    #   detector_rotation_rad, principal_point = [x, y], radial = [k1, k2, ...], optional
    # kind = "cubic":                  focal_length, origin, step, look_sign = [x, y] each,
    #   x_cubic, y_cubic = [c0, c1, c2, c3]; shifts by cubics of the distance from the centre

    [ephemeris]
    epoch_utc = "2020-01-31T12:00:00Z"
    frame = "itrs"                     # or "gcrs", turned to itrs when read
    kind = "lagrange"                  # table: t_s,x_m,y_m,z_m
    points = 8                         #   optional
    table = "ephemeris.csv"
    # kind = "spline":                 the same table, cubic spline
    # kind = "hermite":                t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s
    # kind = "lagrange-equal-steps":   start_s, step_s, order = 8 or 4; table x_m,y_m,z_m.
    #                                  As CSM does it: the stencil narrows towards the ends
    # kind = "polynomial":             offset_s, scale_s, span_s = [from, to]; table x_m,y_m,z_m,
    #                                  ascending coefficients in (t - offset_s) / scale_s
    # kind = "sum":                    [ephemeris.first], [ephemeris.second]: added

    [attitude]                         # rotation body to frame
    epoch_utc = "2020-01-31T12:00:00Z"
    frame = "itrs"                     # or "gcrs"
    kind = "slerp"                     # or "rotation-spline"; table: t_s,q_x,q_y,q_z,q_w
    table = "attitude.csv"
    # kind = "components":             [attitude.curve] of q_x,q_y,q_z,q_w, normalised after;
    #                                  kinds and keys as in [ephemeris]
    # kind = "euler":                  sequence = "ZXY" (intrinsic), [attitude.curve] of
    #                                  a1_rad,a2_rad,a3_rad
    # kind = "product":                [attitude.outer], [attitude.inner]: one after the other
    tabulated_error_rad = 1e-11        # optional: what the writer's dense table misses
    covariance = "covariance.csv"      # optional: t_s,c_xx,c_xy,c_xz,c_yx,...,c_zz in rad^2
    lag_one = "lag_one.csv"            # optional, with covariance: c_xx,...,c_zz of neighbours

    [corrections]                      # what the directions still lack; all optional
    velocity_aberration = true
    light_time = true
    refraction = { refractivity = 2.77e-4, scale_height_m = 8435.0 }

In hermite tables of components and angles the rates' columns are named `rate_q_x`, ....
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geoposition.arrays import FloatArray, read_only
from geoposition.attitude import (
    Attitude,
    ProductCurve,
    QuaternionCurve,
    continuous_unit_quaternions,
)
from geoposition.camera import LineTiming
from geoposition.corrections import Corrections, Refraction
from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError, EarthOrientationError, GeometryError, SpanError
from geoposition.frames import R_itrs_gcrs
from geoposition.interpolation import LagrangeCurve
from geoposition.named_files import is_there
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.sensors.line_camera import LineCamera
from geoposition.sensors.readers.camera_file import read_camera_file
from geoposition.sensors.readers.model_file_camera import read_ccds, read_mounting
from geoposition.sensors.readers.model_file_curves import (
    POSITION,
    read_curve,
    read_rotations,
)
from geoposition.sensors.timing import ConstantLineRate, LineTimeTable
from geoposition.tomlfile import TomlNode, read_toml

if TYPE_CHECKING:
    from geoposition.sensors.readers.source import Source

FORMAT = "geoposition model file"
CANDIDATES = ("*.toml", "**/*.toml")
MARK = "geoposition model"
VERSION = 1

COVARIANCE = tuple(f"c_{a}{b}" for a in "xyz" for b in "xyz")

_ITRS_STEP_S = 1.0
"""Step of the tables that a gcrs ephemeris or attitude becomes; 8-point Lagrange in between."""


def recognises(source: Source) -> bool:
    """Whether `source` is TOML that says it is ours."""
    if source.path.suffix.lower() != ".toml":
        return False
    lines = source.head.decode("utf-8", "replace").splitlines()
    return any(line.split("=")[0].strip() == "format" and MARK in line for line in lines)


def read(source: Source) -> Product:
    """Read the model file `source`."""
    return read_model_file(source.path)


def read_model_file(path: str | Path) -> Product:
    """Read the model file `path`; its `model` is a `PushbroomModel`.

    Raises `ProductError` with the file and the key, or the table and the line, at fault.
    """
    root = read_toml(Path(path))
    if root.text("format") != MARK:
        root.refuse("format", f'"{MARK}" expected')
    if root.need("version") != VERSION:
        root.refuse("version", f"{VERSION} expected, newer files need a newer toolkit")
    low, high = root.numbers("height_range_m", 2)
    timing = _timing(root.child("timing"))
    camera = _camera(root, timing)
    ephemeris, attitude = _ephemeris(root.child("ephemeris")), _attitude(root.child("attitude"))
    corrections = Corrections()
    if root.has("corrections"):
        corrections = _corrections(root.child("corrections"))
    sensor, image = root.text("sensor", ""), _image(root)
    root.finish()
    try:
        model = PushbroomModel(camera, ephemeris, attitude, corrections, (float(low), float(high)))
    except (ArgumentError, GeometryError, SpanError) as error:
        root.refuse("height_range_m" if "height" in str(error) else "timing", str(error))
    return Product(
        path=root.path,
        format=FORMAT,
        sensor=sensor,
        model=model,
        image_path=image,
        start=timing.epoch + float(timing.time_s(0.0)),
    )


def _timing(node: TomlNode) -> LineTiming:
    epoch = node.epoch()
    timing: LineTiming
    try:
        if node.choice("kind", "rate", "table") == "rate":
            first_s, period_s = node.number("first_line_s"), node.number("line_period_s")
            timing = ConstantLineRate(epoch, first_s, period_s)
        else:
            table = node.table("table", "line", "t_s", rows=2)
            timing = LineTimeTable(epoch, table[:, 0], table[:, 1])
    except ArgumentError as error:
        node.refuse("table" if node.has("table") else "line_period_s", str(error))
    node.finish()
    return timing


def _camera(root: TomlNode, timing: LineTiming) -> LineCamera:
    lines = root.whole("lines", 1)
    if not root.has("camera"):
        return LineCamera(lines, timing, read_ccds(root), read_mounting(root))
    for key in ("ccd", "mounting"):
        if root.has(key):
            root.refuse(key, "given by the camera file already")
    shared = read_camera_file(root.inside("camera"))
    return LineCamera(lines, timing, shared.ccds, shared.mounting)


def _ephemeris(node: TomlNode) -> Ephemeris:
    epoch, frame = node.epoch(), node.choice("frame", "itrs", "gcrs")
    ephemeris = Ephemeris(epoch, read_curve(node, POSITION))
    node.finish()
    if frame == "itrs":
        return ephemeris
    times = _turning_times(ephemeris.span_s)
    try:
        R_itrs = R_itrs_gcrs(epoch, times)
    except EarthOrientationError as error:
        node.refuse("epoch_utc", str(error))
    return Ephemeris(epoch, LagrangeCurve(times, R_itrs.apply(ephemeris.position_m(times)), 8))


def _attitude(node: TomlNode) -> Attitude:
    epoch, frame = node.epoch(), node.choice("frame", "itrs", "gcrs")
    node.number("tabulated_error_rad", 0.0)
    curve = read_rotations(node)
    attitude = Attitude(epoch, curve, "itrs", *_covariance(node))
    node.finish()
    if frame == "itrs":
        return attitude
    times = _turning_times(curve.span_s)
    try:
        R_itrs = R_itrs_gcrs(epoch, times)
    except EarthOrientationError as error:
        node.refuse("epoch_utc", str(error))
    quats = continuous_unit_quaternions(times, R_itrs.as_quat())
    turning = QuaternionCurve(LagrangeCurve(times, quats, 8))
    return replace(attitude, curve=ProductCurve(turning, curve))


def _turning_times(span_s: tuple[float, float]) -> FloatArray:
    """Equal steps of about `_ITRS_STEP_S` over a span, enough for 8 points."""
    count = max(8, int(np.ceil((span_s[1] - span_s[0]) / _ITRS_STEP_S)) + 1)
    return np.linspace(*span_s, count)


def _covariance(
    node: TomlNode,
) -> tuple[FloatArray | None, FloatArray | None, FloatArray | None]:
    """Read times, covariance and lag-one cross-covariance, where given."""
    if not node.has("covariance"):
        return None, None, None
    table = node.table("covariance", "t_s", *COVARIANCE)
    if np.any(np.diff(table[:, 0]) <= 0):
        node.refuse("covariance", "strictly increasing times expected")
    lag_one = None
    if node.has("lag_one"):
        rows = node.table("lag_one", *COVARIANCE)
        if len(rows) != len(table) - 1:
            node.refuse("lag_one", f"{len(table) - 1} rows expected, got {len(rows)}")
        lag_one = read_only(rows.reshape(-1, 3, 3))
    return read_only(table[:, 0]), read_only(table[:, 1:].reshape(-1, 3, 3)), lag_one


def _corrections(node: TomlNode) -> Corrections:
    refraction = None
    if node.has("refraction"):
        child = node.child("refraction")
        refraction = Refraction(child.number("refractivity"), child.number("scale_height_m"))
        child.finish()
        if refraction.refractivity < 0 or refraction.scale_height_m <= 0:
            node.refuse("refraction", "a refractivity from 0 and a positive scale height expected")
    corrections = Corrections(node.flag("velocity_aberration"), node.flag("light_time"), refraction)
    node.finish()
    return corrections


def _image(root: TomlNode) -> Path | None:
    """Find the image, where it is there; its path is plain, but may lead out of the folder."""
    if not root.has("image"):
        return None
    name = root.text("image")
    if not name or "\0" in name or "://" in name or name.startswith("/vsi"):
        root.refuse("image", "the path of a file expected")
    path = root.path.parent / name
    return path if is_there(path) else None
