"""What was measured in images and on the ground: tie points and control points, as columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geoposition.arrays import FloatArray, IntArray, as_components, read_only, require_finite
from geoposition.errors import ArgumentError

Ids: TypeAlias = NDArray[np.str_] | NDArray[np.int64]
"""Identifiers of points: texts, or 64-bit integers where there are millions."""


@dataclass(frozen=True, slots=True, eq=False)
class TiePoints:
    """Image points of the same ground seen in several products, one row per observation.

    `ids` (n,) are texts or integers; rows with the same id see the same point. `product` (n,)
    is the index of the image. `image_px` (n, 2) is (line, sample). `covariance_px2` (n, 2, 2),
    if known, belongs to `image_px`. Image points that are not finite are allowed: they are
    flagged where they are used. A point observed twice in one product, a negative product or a
    covariance that is none is an `ArgumentError`.
    """

    ids: Ids
    product: IntArray
    image_px: FloatArray
    covariance_px2: FloatArray | None = None

    def __post_init__(self) -> None:
        ids = _as_ids(self.ids, "tie points: ids")
        product = _as_products(self.product)
        image = read_only(as_components(self.image_px, 2, "tie points: image points"))
        if image.ndim != 2 or not len(ids) == len(product) == len(image):
            raise ArgumentError(
                f"tie points: one id, product and image point per row expected, got "
                f"{len(ids)}, {len(product)} and {image.shape}"
            )
        repeated = _first_repeated(ids, product)
        if repeated is not None:
            raise ArgumentError(
                f"tie points: point {ids[repeated]} is given twice for product "
                f"{product[repeated]} (row {repeated})"
            )
        object.__setattr__(self, "ids", ids)
        object.__setattr__(self, "product", product)
        object.__setattr__(self, "image_px", image)
        if self.covariance_px2 is not None:
            covariance = _as_covariance(self.covariance_px2, len(ids), 2, "tie points: covariance")
            object.__setattr__(self, "covariance_px2", covariance)

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def of_pair(
        cls,
        image_a_px: ArrayLike,
        image_b_px: ArrayLike,
        ids: ArrayLike | None = None,
        products: tuple[int, int] = (0, 1),
    ) -> TiePoints:
        """Tie points of two images: row i of `image_a_px` (n, 2) matches row i of `image_b_px`.

        The points are numbered from 0 unless `ids` (n,) names them.
        """
        a = as_components(image_a_px, 2, "image points of the first image").reshape(-1, 2)
        b = as_components(image_b_px, 2, "image points of the second image").reshape(-1, 2)
        if len(a) != len(b):
            raise ArgumentError(f"a pair: as many points in both expected, got {len(a)}, {len(b)}")
        names = np.arange(len(a)) if ids is None else np.asarray(ids)
        return cls(
            ids=np.concatenate([names, names]),
            product=np.repeat(np.array(products, dtype=np.int64), len(a)),
            image_px=np.concatenate([a, b]),
        )

    def of_product(self, product: int) -> IntArray:
        """Rows that belong to `product`."""
        return np.flatnonzero(self.product == product)

    def shifted(self, product: int, shift_px: ArrayLike) -> TiePoints:
        """Return the tie points with `shift_px` (2,) added to those of `product`."""
        image = self.image_px.copy()
        image[self.product == product] += as_components(shift_px, 2, "shift")
        return TiePoints(self.ids, self.product, image, self.covariance_px2)

    def selected(self, rows: NDArray[np.bool_] | IntArray) -> TiePoints:
        """Return the observations of `rows`, a mask or indices."""
        covariance = self.covariance_px2
        return TiePoints(
            self.ids[rows],
            self.product[rows],
            self.image_px[rows],
            None if covariance is None else covariance[rows],
        )

    def require_products(self, count: int) -> None:
        """Raise an `ArgumentError` if a product is none of the `count` known ones."""
        unknown = np.flatnonzero(self.product >= count)
        if len(unknown):
            row = int(unknown[0])
            raise ArgumentError(
                f"tie points: product {self.product[row]} of point {self.ids[row]} is unknown, "
                f"0 .. {count - 1} expected"
            )

    def grouped(self) -> Grouping:
        """Observations of each point together, the points in the order they first appear."""
        if len(self.ids) == 0:
            nothing = np.empty(0, dtype=np.int64)
            return Grouping(self.ids, np.zeros(1, dtype=np.int64), nothing)
        _, first, point = np.unique(self.ids, return_index=True, return_inverse=True)
        rank = np.empty(len(first), dtype=np.int64)
        appearance = np.argsort(first)
        rank[appearance] = np.arange(len(first))
        point = rank[point]
        order = np.lexsort((self.product, point))
        start = np.concatenate([[0], np.cumsum(np.bincount(point))]).astype(np.int64)
        return Grouping(self.ids[first[appearance]], start, order.astype(np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Rows by point: those of point i are `order[start[i]:start[i + 1]]`, products ascending.

    `ids` (n,) of the points, `start` (n + 1,), `order` (observations,).
    """

    ids: Ids
    start: IntArray
    order: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class ControlPoints:
    """Points of known ground position, and where images show them, if that was measured.

    `ids` (n,), each once; `geodetic` (n, 3) = (lon_rad, lat_rad, height_m), finite;
    `covariance_enu_m2` (n, 3, 3) of the position, east, north, up. `image`, if given, holds the
    measurements; its ids must all be among `ids`. Anything else is an `ArgumentError`.
    """

    ids: Ids
    geodetic: FloatArray
    covariance_enu_m2: FloatArray
    image: TiePoints | None = None

    def __post_init__(self) -> None:
        ids = _as_ids(self.ids, "control points: ids")
        geodetic = read_only(as_components(self.geodetic, 3, "control points"))
        if geodetic.shape != (len(ids), 3):
            raise ArgumentError(
                f"control points: one position per id expected, got {len(ids)} and {geodetic.shape}"
            )
        require_finite(geodetic, "control points")
        if np.any(np.abs(geodetic[:, 1]) > 0.5 * np.pi):
            raise ArgumentError("control points: latitudes in radians expected")
        repeated = _first_repeated(ids, np.zeros(len(ids), dtype=np.int64))
        if repeated is not None:
            raise ArgumentError(f"control points: {ids[repeated]} is given twice")
        covariance = _as_covariance(
            self.covariance_enu_m2, len(ids), 3, "control points: covariance"
        )
        if self.image is not None:
            strange = np.flatnonzero(~np.isin(self.image.ids, ids))
            if len(strange):
                raise ArgumentError(
                    f"control points: {self.image.ids[strange[0]]} is measured in an image and "
                    f"has no ground position"
                )
        object.__setattr__(self, "ids", ids)
        object.__setattr__(self, "geodetic", geodetic)
        object.__setattr__(self, "covariance_enu_m2", covariance)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def sigma_enu_m(self) -> FloatArray:
        """Standard deviations east, north, up (n, 3)."""
        return np.sqrt(np.diagonal(self.covariance_enu_m2, axis1=1, axis2=2))


def diagonal_covariance(sigma: ArrayLike, n: int, size: int) -> FloatArray:
    """Covariances (n, size, size) of components with `sigma`: one, (size,) or (n, size)."""
    sigmas = np.broadcast_to(np.asarray(sigma, dtype=np.float64), (n, size))
    covariance = np.zeros((n, size, size))
    covariance[:, range(size), range(size)] = sigmas**2
    return covariance


def _as_ids(ids: ArrayLike, name: str) -> Ids:
    array = np.asarray(ids)
    if array.ndim != 1:
        raise ArgumentError(f"{name}: one per row expected, got shape {array.shape}")
    result: Ids
    if array.dtype.kind in "iu":
        result = array.astype(np.int64)
    elif array.dtype.kind in "UOS" or array.size == 0:
        result = array.astype(np.str_)
    else:
        raise ArgumentError(f"{name}: texts or integers expected, got {array.dtype}")
    result.setflags(write=False)
    return result


def _as_products(products: ArrayLike) -> IntArray:
    array = np.asarray(products)
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise ArgumentError("tie points: one integer per row expected as product")
    product = array.astype(np.int64)
    if np.any(product < 0):
        row = int(np.argmax(product < 0))
        raise ArgumentError(f"tie points: product {product[row]} (row {row}) is negative")
    product.setflags(write=False)
    return product


def _as_covariance(values: ArrayLike, n: int, size: int, name: str) -> FloatArray:
    """Check that `values` (n, size, size) are symmetric with a positive diagonal."""
    covariance = read_only(values)
    if covariance.shape != (n, size, size):
        raise ArgumentError(f"{name}: shape {(n, size, size)} expected, got {covariance.shape}")
    require_finite(covariance, name)
    scale = np.abs(np.diagonal(covariance, axis1=1, axis2=2)).max(axis=1, initial=0.0)
    lopsided = np.abs(covariance - covariance.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
    bad = (lopsided > 1e-9 * scale) | (np.linalg.eigvalsh(covariance)[:, 0] <= 0.0)
    if np.any(bad):
        raise ArgumentError(
            f"{name}: symmetric and positive expected, entry {np.argmax(bad)} is not"
        )
    return covariance


def _first_repeated(ids: Ids, product: IntArray) -> int | None:
    """First row whose id and product both occurred before, or None."""
    if len(ids) < 2:
        return None
    order = np.lexsort((product, ids))
    same = (ids[order[1:]] == ids[order[:-1]]) & (product[order[1:]] == product[order[:-1]])
    return int(order[1:][same].min()) if np.any(same) else None
