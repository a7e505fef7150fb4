"""Which matches to believe: beside the models' chords by one amount, among neighbours like them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from geoposition.arrays import BoolArray, FloatArray
from geoposition.errors import GeometryError

NMAD: Final = 1.4826
"""Standard deviation of a normal distribution per median absolute deviation."""

_HALF_WIDTH_PX: Final = 2.0
_FEWEST: Final = 8
_NEIGHBOURS: Final = 12
_REWEIGHTINGS: Final = 8
_RIDGE: Final = 1e-3
_PARALLAX_FLOOR_PX: Final = 4.0
_ACROSS_FLOOR_PX: Final = 0.3
_SIGMAS: Final = 4.0


@dataclass(frozen=True, slots=True)
class Offset:
    """By how much matches lie beside their chords: middle and scatter in px, and how many do."""

    across_px: float
    scatter_px: float
    count: int


def common_offset(across_px: FloatArray, band_px: float) -> Offset:
    """Find the offset that most matches share, among false ones anywhere within ± `band_px`.

    `GeometryError` where no offset stands out of what chance would heap up.
    """
    values = np.sort(across_px)
    count = np.searchsorted(values, values + 2.0 * _HALF_WIDTH_PX, side="right") - np.arange(
        len(values)
    )
    by_chance = len(values) * _HALF_WIDTH_PX / max(band_px, _HALF_WIDTH_PX)
    most = int(count.max()) if len(count) else 0
    if most < _FEWEST + by_chance + 5.0 * np.sqrt(by_chance) and not (
        # Nearly all agree: a small band leaves no room for chance.
        most >= _FEWEST and most >= 0.8 * len(values) and band_px > 4.0 * _HALF_WIDTH_PX
    ):
        raise GeometryError(
            f"matching: of {len(values)} candidates no {_FEWEST} agree on one offset between "
            f"the images within {band_px:.0f} px; they show no common ground or no texture"
        )
    at = int(np.argmax(count))
    middle = float(np.median(values[at : at + most]))
    for _ in range(3):
        near = values[np.abs(values - middle) <= 2.0 * _HALF_WIDTH_PX]
        middle = float(np.median(near))
    scatter = NMAD * float(np.median(np.abs(near - middle)))
    return Offset(middle, scatter, len(near))


def near_offset(across_px: FloatArray) -> BoolArray:
    """Tell which offsets lie with the bulk: within four NMADs, at least `_ACROSS_FLOOR_PX`."""
    off = np.abs(across_px - np.median(across_px))
    return np.asarray(off <= max(_SIGMAS * NMAD * float(np.median(off)), _ACROSS_FLOOR_PX))


def like_neighbours(first_px: FloatArray, along_px: FloatArray) -> BoolArray:
    """Tell which matches have a parallax (n,) like that of their neighbours in the first image.

    The neighbours' parallax is a plane, fitted so that the sum of distances is least: slopes of
    the ground are no errors, and wrong neighbours do not lead it astray. What the neighbours
    themselves scatter about it is allowed for.
    """
    n = len(first_px)
    if n <= _NEIGHBOURS:
        return np.ones(n, dtype=np.bool_)
    reach, near = cKDTree(first_px).query(first_px, k=_NEIGHBOURS + 1)
    near = near[:, 1:]
    place = (first_px[near] - first_px[:, None]) / np.maximum(reach[:, -1], 1.0)[:, None, None]
    terms = np.concatenate([np.ones((n, _NEIGHBOURS, 1)), place], axis=-1)
    around = along_px[near] - np.median(along_px[near], axis=1, keepdims=True)
    weight = np.ones_like(around)
    misfit = around
    plane = np.zeros((n, 3))
    for _ in range(_REWEIGHTINGS):
        weighted = terms * weight[..., None]
        normal = np.einsum("nki,nkj->nij", weighted, terms) + _RIDGE * np.eye(3)
        right = np.einsum("nki,nk->ni", weighted, around)
        plane = np.linalg.solve(normal, right[..., None])[..., 0]
        misfit = np.abs(around - np.einsum("nki,ni->nk", terms, plane))
        weight = 1.0 / np.maximum(misfit, 1.0)
    spread = NMAD * np.median(misfit, axis=1)
    off = np.abs(along_px - np.median(along_px[near], axis=1) - plane[:, 0])
    return np.asarray(off <= _PARALLAX_FLOOR_PX + _SIGMAS * spread)


def first_of_place(first_px: FloatArray, second_px: FloatArray, rank: FloatArray) -> BoolArray:
    """Keep, of matches at one place of either image, the one of least `rank`."""
    keep = np.zeros(len(rank), dtype=np.bool_)
    keep[np.argsort(rank, kind="stable")] = True
    for points in (first_px, second_px):
        cell = np.rint(points * 2.0).astype(np.int64)
        order = np.lexsort((rank, cell[:, 1], cell[:, 0]))
        again = np.concatenate([[False], np.all(np.diff(cell[order], axis=0) == 0, axis=1)])
        keep[order[again]] = False
    return keep
