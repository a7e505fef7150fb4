"""VECTORS tables: directions seen in the body beside those known in the reference frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from geoposition.arrays import FloatArray, read_only
from geoposition.errors import ProductError
from geoposition.sensors.readers.table_file import load_table
from geoposition.sensors.telemetry import Mounting

_BODY: Final = ("body_x", "body_y", "body_z")
_REFERENCE: Final = ("ref_x", "ref_y", "ref_z")
_LENGTH_TOLERANCE: Final = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class VectorTable:
    """Directions of all epochs, in the order of time.

    `body` and `reference` (n, 3) are unit, `sigma_rad` (n,) is the noise across the direction.
    `first` (k + 1,) are the rows at which the epochs `times_s` (k,) begin, and the end.
    """

    path: Path
    times_s: FloatArray
    first: NDArray[np.intp]
    body: FloatArray
    reference: FloatArray
    sigma_rad: FloatArray


def read_vectors(path: Path, mounting: Mounting | None = None) -> VectorTable:
    """Read a VECTORS table `t_s,sensor,id,body_x..z,ref_x..z,sigma_rad`.

    With a mounting the directions are the sensor's own and are turned to the body. `sensor` and
    `id` may be absent. Rows of one time belong together.
    """
    table = load_table(path)
    table.require(("t_s", *_BODY, *_REFERENCE, "sigma_rad"), ("sensor", "id"))
    times = table.strict("t_s")
    body, reference = (
        np.stack([table.strict(name) for name in names], axis=1) for names in (_BODY, _REFERENCE)
    )
    for names, vectors in ((_BODY, body), (_REFERENCE, reference)):
        length = np.linalg.norm(vectors, axis=1)
        bad = np.flatnonzero(np.abs(length - 1.0) > _LENGTH_TOLERANCE)
        if len(bad):
            row = int(bad[0])
            table.refuse(row, names[0], f"a unit vector expected, its length is {length[row]:.6g}")
        vectors /= length[:, None]
    sigma = table.strict("sigma_rad")
    bad = np.flatnonzero(sigma <= 0.0)
    if len(bad):
        table.refuse(int(bad[0]), "sigma_rad", "a positive number expected")
    if mounting is not None:
        if "sensor" not in table.names:
            raise ProductError(path, "header", "column sensor expected, as a mounting is given")
        sensor = table.text("sensor")
        for name in np.unique(sensor):
            mine = sensor == name
            body[mine] = mounting.rotation(str(name)).apply(body[mine])
    order = np.argsort(times, kind="stable")
    epochs, first = np.unique(times[order], return_index=True)
    return VectorTable(
        path,
        read_only(epochs),
        np.append(first, len(times)),
        read_only(body[order]),
        read_only(reference[order]),
        read_only(sigma[order]),
    )
