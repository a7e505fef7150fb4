"""EPH tables `t_s,x,y,z,vx,vy,vz`, metres and metres per second, in a stated frame.

The frame is said by a remark (`# frame: itrs`), by the columns' names (`x_itrs`, `vx_itrs`, ...)
or by the caller.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray, read_only
from geoposition.ephemeris import Frame
from geoposition.errors import ProductError
from geoposition.sensors.readers.attitude_columns import TimeColumn
from geoposition.sensors.readers.table_file import TableFile, load_table
from geoposition.sensors.readers.table_times import read_times
from geoposition.timescale import Epoch

_FRAMES: Final[dict[str, Frame]] = {
    **dict.fromkeys(("itrs", "itrf", "ecef", "wgs84", "earth-fixed"), "itrs"),
    **dict.fromkeys(("gcrs", "gcrf", "eci", "inertial", "icrf", "icrs", "j2000"), "gcrs"),
}
_COMPONENTS: Final = ("x", "y", "z", "vx", "vy", "vz")
_SHORTEST_RADIUS_M: Final = 1e5


@dataclass(frozen=True, slots=True, eq=False)
class EphemerisTable:
    """Positions and velocities (n, 3) in `frame` at `times_s` (n,) from `epoch`, if known."""

    path: Path
    times_s: FloatArray
    position_m: FloatArray
    velocity_m_s: FloatArray
    frame: Frame
    epoch: Epoch | None = None


def frame_of(name: str) -> Frame | None:
    """`itrs` or `gcrs` from the many names of the two."""
    return _FRAMES.get(name.strip().lower())


def read_ephemeris(
    path: Path, frame: Frame | None = None, epoch: Epoch | None = None
) -> EphemerisTable:
    """Read an EPH table; `frame` overrides nothing: a file that says another one is refused."""
    table = load_table(path)
    ending, named = _columns(table)
    time = TimeColumn("t_s")
    if "t_s" not in table.names and "utc" in table.names:
        time = TimeColumn("utc", utc=True)
    table.require((time.column, *(name + ending for name in _COMPONENTS)))
    stated = named or _remark(table)
    if stated is not None and frame is not None and stated != frame:
        raise ProductError(path, "header", f"the file says its frame is {stated}, not {frame}")
    used = stated or frame
    if used is None:
        raise ProductError(path, "header", "a remark '# frame: itrs' (or gcrs) or --frame expected")
    times, start = read_times(table, time, epoch)
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if len(back):
        table.refuse(int(back[0]) + 1, time.column, "times that increase expected")
    if len(times) < 2:
        raise ProductError(path, "", "two rows or more expected")
    values = np.stack([table.strict(name + ending) for name in _COMPONENTS], axis=1)
    radius = np.linalg.norm(values[:, :3], axis=1)
    low = np.flatnonzero(radius < _SHORTEST_RADIUS_M)
    if len(low):
        table.refuse(
            int(low[0]), "x" + ending,
            f"a position in metres from the planet's centre expected, its length is "
            f"{radius[low[0]]:.6g}",
        )  # fmt: skip
    return EphemerisTable(
        path, read_only(times), read_only(values[:, :3]), read_only(values[:, 3:]), used, start
    )


def _columns(table: TableFile) -> tuple[str, Frame | None]:
    """Return what follows x, y, z in the columns' names, and the frame that it says."""
    for name in table.names:
        if name == "x":
            return "", None
        if name.startswith("x_"):
            frame = frame_of(name.split("_")[1])
            if frame is not None:
                return name[1:], frame
    return "", None


def _remark(table: TableFile) -> Frame | None:
    text = table.remark("frame")
    if text is None:
        return None
    frame = frame_of(text)
    if frame is None:
        raise ProductError(table.path, "header", f"frame itrs or gcrs expected, got {text[:20]!r}")
    return frame
