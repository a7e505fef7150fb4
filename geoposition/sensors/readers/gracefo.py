"""GRACE-FO Level-1 attitude products, ASCII: star heads, gyros, head alignments.

========  ==================================================================================
SCA1A     raw quaternions of three heads, 2 Hz, on-board clock: R_inertial_head, scalar first
SCA1B     fused attitude, 1 Hz, GPS time: R_inertial_body (body = science reference frame)
IMU1A/B   accumulated angle of each gyro in degrees, 8 Hz, on-board clock / GPS time
QSA1B     R_head_body of each head, scalar first
========  ==================================================================================

The directions were found by closing the chain: SCA1A after QSA1B equals SCA1B within the heads'
alignment errors of 0.05 degrees. Times are seconds since 2000-01-01T12:00:00 of the product's
clock. A head's boresight is its +z.

*Source*: GRACE-FO Level-1 Data Product User Handbook, JPL D-56935.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, IntArray, as_components
from geoposition.errors import ArgumentError, MissingFileError, ProductError
from geoposition.rotation import quat_xyzw_from_wxyz
from geoposition.sensors.telemetry import GyroSeries, Mounting, StarSeries
from geoposition.timescale import Epoch

EPOCH: Final = Epoch.from_gps_seconds(630_763_200.0)
"""2000-01-01T12:00:00 GPS time, from which all products count."""

SIGMA_CROSS_RAD: Final = np.radians(2.8 / 3600.0)
SIGMA_BORE_RAD: Final = np.radians(29.0 / 3600.0)
"""Noise of a raw head about its axes, which SCA1A does not state: the scatter of 2023-06-01
about a smooth curve (1 to 3 arcsec across, 20 to 36 about the boresight)."""

_AXES_BODY: Final = np.array(
    [
        [0.0, np.sqrt(2.0 / 3.0), np.sqrt(1.0 / 3.0)],
        [np.sqrt(2.0 / 3.0), 0.0, -np.sqrt(1.0 / 3.0)],
        [0.0, -np.sqrt(2.0 / 3.0), np.sqrt(1.0 / 3.0)],
        [-np.sqrt(2.0 / 3.0), 0.0, -np.sqrt(1.0 / 3.0)],
    ]
)
_WRAP_DEG: Final = 2.0 * 5758.0
_MARKS: Final = ("# End of YAML header", "END OF HEADER")
_VALID_BIT: Final = -1


@dataclass(frozen=True, slots=True)
class _Records:
    """Rows of a product after its header, as words, with the line of the first."""

    path: Path
    rows: list[list[str]]
    lines: list[int]

    def column(self, index: int, convert: Callable[[str], float] = float) -> FloatArray:
        """Numbers of one column; anything else is a `ProductError` with its place."""
        values = np.empty(len(self.rows))
        for k, row in enumerate(self.rows):
            try:
                values[k] = convert(row[index])
            except ValueError:
                self.refuse(k, index, f"a number expected, got {row[index][:20]!r}")
            if not np.isfinite(values[k]):
                self.refuse(k, index, "a finite number expected")
        return values

    def refuse(self, row: int, column: int, expected: str) -> None:
        """Raise a `ProductError` about one cell."""
        raise ProductError(self.path, f"line {self.lines[row]}, column {column + 1}", expected)

    def times_s(self) -> FloatArray:
        """Whole seconds and microseconds of the first two columns."""
        return self.column(0) + 1e-6 * self.column(1)

    def quat_xyzw(self, first: int) -> FloatArray:
        """Quaternions (n, 4) from four columns, scalar first."""
        quat = np.stack([self.column(first + k) for k in range(4)], axis=1)
        norm = np.linalg.norm(quat, axis=1)
        bad = np.flatnonzero(np.abs(norm - 1.0) > 1e-3)
        if len(bad):
            self.refuse(
                int(bad[0]), first, f"a unit quaternion expected, its norm is {norm[bad[0]]:.6g}"
            )
        return quat_xyzw_from_wxyz(quat / norm[:, None])


def product_kind(path: Path) -> str | None:
    """`SCA1A`, `SCA1B`, `IMU1A`, `IMU1B` or `QSA1B` where a file says it is one, by content."""
    try:
        with path.open("rb") as file:
            head = file.read(16384).decode("ascii", "replace")
    except OSError:
        return None
    if head.startswith("PRODUCER AGENCY") and "QSA1B" in head:
        return "QSA1B"
    if not (head.startswith("header:") and "GRACE-FO" in head):
        return None
    for title, kind in (("Star Camera Data", "SCA"), ("IMU Data", "IMU")):
        for level in ("1A", "1B"):
            if f"title: GRACE-FO Level-{level} {title}" in head:
                return kind + level
    return None


def read_sca1a(
    path: str | Path,
    sigma_cross_rad: float = SIGMA_CROSS_RAD,
    sigma_bore_rad: float = SIGMA_BORE_RAD,
) -> StarSeries:
    """Raw quaternions of all heads, R_inertial_head, without the samples a head calls invalid.

    Heads are named `sca1`, `sca2`, `sca3`. Times are those of the on-board clock.
    """
    records = _records(Path(path), 16)
    mode = [row[14] for row in records.rows]
    valid = np.array([word[_VALID_BIT] == "1" for word in mode])
    if not valid.any():
        raise ProductError(path, "column 15", "no sample is marked valid")
    numbers = _identity(records, 3, 3)
    used = sorted(set(numbers[valid].tolist()))
    head = np.searchsorted(used, numbers)
    return _star(
        records.path,
        records.times_s()[valid],
        records.quat_xyzw(5)[valid],
        np.full(int(valid.sum()), sigma_cross_rad),
        np.full(int(valid.sum()), sigma_bore_rad),
        head[valid],
        tuple(f"sca{number}" for number in used),
    )


def read_sca1b(path: str | Path) -> StarSeries:
    """Fused attitude R_inertial_body; noise from the product's formal error."""
    records = _records(Path(path), 9)
    # The formal error is that of the quaternion, half that of the rotation, over three axes.
    sigma = np.maximum(2.0 * records.column(7) / np.sqrt(3.0), 1e-9)
    return _star(
        records.path, records.column(0), records.quat_xyzw(3), sigma, sigma,
        np.zeros(len(sigma), dtype=np.int64), ("srf",),
    )  # fmt: skip


def read_qsa1b(path: str | Path) -> Mounting:
    """R_body_head of the heads `sca1`, `sca2`, `sca3`."""
    records = _records(Path(path), 9)
    rotations = Rotation.from_quat(records.quat_xyzw(3)).inv()
    numbers = _identity(records, 2, 3)
    return Mounting({f"sca{number}": rotations[k] for k, number in enumerate(numbers.tolist())})


def read_imu(path: str | Path, axes_body: ArrayLike | None = None) -> GyroSeries:
    """Increments about the body's axes from the gyros of IMU1A or IMU1B, at the first one's times.

    `axes_body` (n, 3) are the input axes of gyros 1, 2, ... in the body. The product does not
    state them; None takes the regular tetrahedron whose edges 1-3 and 2-4 lie along pitch and
    roll. It agrees with the fused attitude about pitch to 5e-4; about the other two axes the
    satellite hardly turned in the data at hand, so the order of gyros 2 and 4 is unchecked.
    """
    records = _records(Path(path), 7)
    axes = _AXES_BODY if axes_body is None else as_components(axes_body, 3, "gyro axes")
    number = _identity(records, 4, len(axes))
    used = sorted(set(number.tolist()))
    if len(used) < 3 or np.linalg.matrix_rank(axes[np.array(used) - 1]) < 3:
        raise ProductError(path, "column 5", "three gyros with independent axes expected")
    times = records.times_s()
    angle_deg = records.column(5)
    series = []
    for gyro in used:
        mine = number == gyro
        if mine.sum() < 2 or np.any(np.diff(times[mine]) <= 0.0):
            raise ProductError(
                path, f"gyro {gyro}", "two samples or more, times increasing, expected"
            )
        series.append((times[mine], np.radians(np.unwrap(angle_deg[mine], period=_WRAP_DEG))))
    low = max(t[0] for t, _ in series)
    high = min(t[-1] for t, _ in series)
    first = series[0][0]
    common = first[(first >= low) & (first <= high)]
    if len(common) < 2:
        raise ProductError(path, "", "gyros that share a span of two samples or more expected")
    # The gyros are read out a millisecond apart; the rate hardly changes in that time.
    angles = np.stack([np.interp(common, t, a) for t, a in series], axis=1)
    body = np.linalg.lstsq(axes[np.array(used) - 1], angles.T, rcond=None)[0].T
    increments = np.diff(body, axis=0, prepend=body[:1])
    return GyroSeries.of(common, increments, "increment")


def _star(
    path: Path,
    times: FloatArray,
    quat: FloatArray,
    cross: FloatArray,
    bore: FloatArray,
    head: IntArray,
    heads: tuple[str, ...],
) -> StarSeries:
    try:
        return StarSeries.of(times, quat, cross, bore, head, heads)
    except ArgumentError as error:
        raise ProductError(path, "", str(error)) from None


def _identity(records: _Records, column: int, count: int) -> IntArray:
    """Whole numbers from 1 to `count` that name a head or a gyro."""
    number = records.column(column, int)
    bad = np.flatnonzero((number < 1) | (number > count))
    if len(bad):
        records.refuse(int(bad[0]), column, f"a number from 1 to {count} expected")
    return number.astype(np.int64)


def _records(path: Path, columns: int) -> _Records:
    try:
        text = path.read_text(encoding="ascii")
    except FileNotFoundError:
        raise MissingFileError(path, "", "there is no such file") from None
    except UnicodeDecodeError:
        raise ProductError(path, "", "an ASCII product of GRACE-FO expected") from None
    lines = text.splitlines()
    ends = [k for k, line in enumerate(lines) if line.strip() in _MARKS]
    if not ends:
        raise ProductError(path, "", "the end of a GRACE-FO header expected, none found")
    rows, places = [], []
    for k in range(ends[0] + 1, len(lines)):
        words = lines[k].split()
        if not words:
            continue
        if len(words) != columns:
            raise ProductError(
                path, f"line {k + 1}", f"{columns} columns expected, got {len(words)}"
            )
        rows.append(words)
        places.append(k + 1)
    if not rows:
        raise ProductError(path, "", "no records: the product has a header only")
    return _Records(path, rows, places)
