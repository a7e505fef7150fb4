"""The observation equations of groups of points, linearised, their points eliminated.

In units of the prior: the unknowns are z with theta = S z, S Sᵀ the prior covariance, and every
row has unit noise. A group's null-space rows are A (n, q, p) and r (n, q) with the cost
|A (z − z0) + r|² per point, whatever the point itself does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.adjust.point_sets import Group, PointSet
from geoposition.adjust.residual_kernels import back_substitute, eliminate, fill_rows
from geoposition.adjust.residuals import ImageEquations
from geoposition.adjust.sights import Sights
from geoposition.arrays import FloatArray, IntArray
from geoposition.ellipsoid import ecef_to_geodetic, enu_axes
from geoposition.threads import threads_for

_CHUNK: Final = 32768
_WEAK: Final = 1e-4
"""Smallest over largest diagonal of a point's triangle below which it is not determined."""
FIXED_HEIGHT_SIGMA_M: Final = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """Null-space rows of a group at z0, and what gives its points back.

    `columns` (p) among all unknowns; `A` (n, q, p), `r` (n, q); `strong` (n) tells whether the
    point is determined. `triangle` (n, 3, 3), `top` (n, 3, p) and `top_r` (n, 3): the point moves
    by triangle⁻¹ (top (z − z0) + top_r), metres ECEF.
    """

    group: Group
    columns: IntArray
    A: FloatArray
    r: FloatArray
    strong: np.ndarray[tuple[int], np.dtype[np.bool_]]
    triangle: FloatArray
    top: FloatArray
    top_r: FloatArray

    def step_m(self, dz: FloatArray) -> FloatArray:
        """Movement (n, 3) of the points when all unknowns move by `dz`."""
        right = (self.top @ dz[self.columns] + self.top_r)[..., None]
        with threads_for(len(right)):
            back_substitute(self.triangle, right, self.strong)
        return right[..., 0]

    def point_covariance(self, covariance: FloatArray) -> FloatArray:
        """Covariance (n, 3, 3), ECEF, of points whose own noise is not in `covariance` of z."""
        right = np.concatenate([np.broadcast_to(np.eye(3), (len(self.top), 3, 3)), self.top], 2)
        with threads_for(len(right)):
            back_substitute(self.triangle, right, self.strong)
        own, by_unknown = right[:, :, :3], right[:, :, 3:]
        some = covariance[np.ix_(self.columns, self.columns)]
        moved = by_unknown @ some
        result: FloatArray = own @ own.transpose(0, 2, 1) + moved @ by_unknown.transpose(0, 2, 1)
        return result


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """All images' equations and the prior's root S, block by block."""

    images: tuple[ImageEquations, ...]
    S: FloatArray

    def theta(self, z: FloatArray) -> FloatArray:
        """Unknowns in their own units."""
        return np.asarray(self.S @ z, dtype=np.float64)


def group_columns(equations: Equations, group: Group) -> tuple[IntArray, list[IntArray]]:
    """Unknowns of the group's images, and the places of each image's among them."""
    each = [equations.images[i].columns for i in group.images]
    columns = np.unique(np.concatenate(each)) if each else np.empty(0, dtype=np.int64)
    return columns, [np.searchsorted(columns, own) for own in each]


def whitened_rows(
    equations: Equations,
    points: PointSet,
    group: Group,
    part: slice,
    theta: FloatArray,
    known: bool,
) -> FloatArray:
    """Rows (n, 2 m + k, 3 + p + 1): by the point, by the unknowns (theta), and the residual."""
    columns, places = group_columns(equations, group)
    which, rows = group.points[part], group.rows[part]
    n, m = rows.shape
    fixed = not known and m == 1
    k = points.known_root.shape[1] if known else int(fixed)
    work = np.zeros((n, 2 * m + max(k, 3 - 2 * m), 3 + len(columns) + 1))
    ground = points.ecef_m[which]
    for a, image in enumerate(group.images):
        some = taken(points.sights, rows[:, a])
        residual, by_ground, jacobian = equations.images[image].evaluate(some, ground, theta)
        of_root = rows[:, a] if len(points.root) > 1 else np.zeros(n, dtype=np.int64)
        fill_rows(work, 2 * a, points.root, of_root, by_ground, jacobian, residual, places[a])
    if known and k:
        root = points.known_root[which]
        work[:, 2 * m : 2 * m + k, :3] = root
        off = points.known_ecef_m[which] - ground
        work[:, 2 * m : 2 * m + k, -1] = (root @ off[..., None])[..., 0]
    elif fixed:
        up = enu_axes(ecef_to_geodetic(points.known_ecef_m[which]))[:, :, 2]
        work[:, 2 * m, :3] = up / FIXED_HEIGHT_SIGMA_M
        off = np.sum(up * (points.known_ecef_m[which] - ground), axis=1)
        work[:, 2 * m, -1] = off / FIXED_HEIGHT_SIGMA_M
    return work


def linearise(
    equations: Equations,
    points: PointSet,
    group: Group,
    z: FloatArray,
    *,
    known: bool = True,
) -> Linear:
    """Equations of `group` at `z`.

    Without `known`, what is known of the points is not used, but a point in one image keeps its
    height.
    """
    columns, _ = group_columns(equations, group)
    theta = equations.theta(z)
    n, p = len(group.points), len(columns)
    S = equations.S[np.ix_(columns, columns)]
    out: list[FloatArray] = []
    for low in range(0, n, _CHUNK):
        part = slice(low, min(low + _CHUNK, n))
        with threads_for(group.rows[part].size):
            work = whitened_rows(equations, points, group, part, theta, known)
            eliminate(work)
        if not out:
            q = work.shape[1] - 3
            shapes = [(n, q, p), (n, q), (n, 3, 3), (n, 3, p), (n, 3)]
            out = [np.empty(shape) for shape in shapes]
        out[0][part] = _scaled(work[:, 3:, 3 : 3 + p], S)
        out[1][part] = work[:, 3:, -1]
        out[2][part] = work[:, :3, :3]
        out[3][part] = _scaled(work[:, :3, 3 : 3 + p], S)
        out[4][part] = work[:, :3, -1]
    A, r, triangle, top, top_r = out
    diagonal = np.abs(triangle[:, [0, 1, 2], [0, 1, 2]])
    strong = diagonal.min(axis=1) > _WEAK * diagonal.max(axis=1)
    return Linear(group, columns, A, r, strong, triangle, top, top_r)


def _scaled(by_unknown: FloatArray, S: FloatArray) -> FloatArray:
    """By the unknowns in units of the prior, from those in their own."""
    diagonal = np.diagonal(S)
    if np.array_equal(S, np.diag(diagonal)):
        return by_unknown * diagonal
    n, r, p = by_unknown.shape
    result: FloatArray = (np.ascontiguousarray(by_unknown).reshape(-1, p) @ S).reshape(n, r, p)
    return result


def taken(sights: Sights, rows: IntArray) -> Sights:
    """Return the sights of `rows`."""
    return Sights(
        sights.image_px[rows],
        sights.origin_ecef_m[rows],
        sights.direction_ecef[rows],
        sights.scale[rows],
        sights.flag[rows],
    )
