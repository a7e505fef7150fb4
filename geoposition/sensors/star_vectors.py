"""Star directions: from catalogue and image coordinates, and as a head measures them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray, IntArray, as_components, read_only, require_increasing
from geoposition.errors import ArgumentError
from geoposition.sensors.star_sensor import AttitudeCurve, StarHead
from geoposition.sensors.telemetry import Mounting


def direction_of_star(right_ascension_rad: ArrayLike, declination_rad: ArrayLike) -> FloatArray:
    """Return unit vectors (..., 3) in the celestial frame. *Source*: T (2.22), V."""
    a, d = np.broadcast_arrays(
        np.asarray(right_ascension_rad, dtype=np.float64),
        np.asarray(declination_rad, dtype=np.float64),
    )
    return np.stack([np.cos(a) * np.cos(d), np.sin(a) * np.cos(d), np.sin(d)], axis=-1)


def direction_of_image_point(
    x: ArrayLike, y: ArrayLike, focal_length: float, principal_point: tuple[float, float] = (0, 0)
) -> FloatArray:
    """Return unit vectors (..., 3) in the sensor, boresight +z; all lengths in one unit.

    *Source*: T (2.22), U, whose z is −f: there the axis points away from the sky.
    """
    u, v = np.broadcast_arrays(
        np.asarray(x, dtype=np.float64) - principal_point[0],
        np.asarray(y, dtype=np.float64) - principal_point[1],
    )
    direction = np.stack([u, v, np.full(u.shape, focal_length)], axis=-1)
    result: FloatArray = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class StarVectors:
    """Measured and catalogue directions, one row per star and epoch, in the order of time.

    `sensor` (k, 3) in the frame of head `head` (k,), `reference` (k, 3) inertial, both unit;
    `sigma_rad` (k,) about each of the two axes across the star; `star` (k,) identifies it.
    """

    times_s: FloatArray
    head: IntArray
    star: IntArray
    sensor: FloatArray
    reference: FloatArray
    sigma_rad: FloatArray
    heads: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.times_s)

    def body(self, mounting: Mounting) -> FloatArray:
        """Measured directions (k, 3) in the body."""
        result = np.array(self.sensor)
        for index, name in enumerate(self.heads):
            rows = self.head == index
            result[rows] = mounting.rotation(name).apply(result[rows])
        return result


@dataclass(frozen=True, slots=True, eq=False)
class VectorGroups:
    """Directions by epoch: `body`, `reference` (n, m, 3), `sigma_rad` (n, m), NaN where fewer."""

    times_s: FloatArray
    body: FloatArray
    reference: FloatArray
    sigma_rad: FloatArray


def grouped_by_epoch(
    times_s: ArrayLike, body: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike
) -> VectorGroups:
    """Lay out rows (k,) of equal times side by side, for the static methods."""
    times = np.asarray(times_s, dtype=np.float64)
    vectors = as_components(body, 3, "body vectors"), as_components(reference, 3, "references")
    sigma = np.broadcast_to(np.asarray(sigma_rad, dtype=np.float64), times.shape)
    if times.ndim != 1 or any(v.shape != (len(times), 3) for v in vectors):
        raise ArgumentError("vectors: one time, body and reference direction per row expected")
    epochs, row, count = np.unique(times, return_inverse=True, return_counts=True)
    order = np.argsort(row, kind="stable")
    first = np.cumsum(count) - count
    column = np.empty(len(times), dtype=np.int64)
    column[order] = np.arange(len(times)) - first[row[order]]
    shape = (len(epochs), int(count.max(initial=0)))
    padded = [np.full((*shape, 3), np.nan), np.full((*shape, 3), np.nan), np.full(shape, np.nan)]
    for target, source in zip(padded, (*vectors, sigma), strict=True):
        target[row, column] = source
    return VectorGroups(read_only(epochs), *(read_only(part) for part in padded))


def simulate_star_vectors(
    heads: Sequence[StarHead],
    times_s: ArrayLike,
    attitude: AttitudeCurve,
    catalogue: ArrayLike,
    sigma_rad: float,
    rng: np.random.Generator,
    half_field_rad: float = np.radians(10.0),
    max_stars: int = 20,
) -> StarVectors:
    """Directions that each head measures at `times_s` (n,) of the `catalogue` (s, 3) it sees.

    Of the stars within `half_field_rad` of the boresight the first `max_stars` in the catalogue's
    order are taken. The noise is white across the direction, `sigma_rad` per axis, and the head's
    slow errors turn all its stars alike. *Source*: T (2.23); the QUEST measurement model,
    Shuster & Oh 1981.
    """
    times = require_increasing(np.asarray(times_s, dtype=np.float64), "star times")
    stars = as_components(catalogue, 3, "catalogue")
    if not (sigma_rad > 0.0 and 0.0 < half_field_rad <= np.pi and max_stars > 0):
        raise ArgumentError("star vectors: positive noise, field and number of stars expected")
    parts = []
    for index, head in enumerate(heads):
        turn = Rotation.from_rotvec(head.slow_error_rad(times))
        matrix = (attitude(times) * head.R_body_sensor * turn).as_matrix()
        seen = np.einsum("sj,njk->nsk", stars, matrix)
        inside = seen[..., 2] >= np.cos(half_field_rad)
        inside &= np.cumsum(inside, axis=1) <= max_stars
        epoch, star = np.nonzero(inside)
        noise = sigma_rad * rng.standard_normal((len(epoch), 3))
        true = seen[epoch, star]
        across = noise - np.sum(noise * true, axis=-1, keepdims=True) * true
        measured = true + across
        measured /= np.linalg.norm(measured, axis=-1, keepdims=True)
        parts.append((times[epoch], np.full(len(epoch), index), star, measured))
    when, head_index, star_index, sensor = (
        np.concatenate([part[i] for part in parts]) for i in range(4)
    )
    order = np.argsort(when, kind="stable")
    return StarVectors(
        read_only(when[order]),
        head_index[order],
        star_index[order],
        read_only(sensor[order]),
        read_only(stars[star_index[order]]),
        read_only(np.full(len(order), sigma_rad)),
        tuple(head.name for head in heads),
    )
