"""The direct (image to ground) polynomials that some products carry beside the inverse ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geoposition.arrays import FloatArray, read_only
from geoposition.errors import ArgumentError
from geoposition.rpc.start import cubic_terms


@dataclass(frozen=True, slots=True, eq=False)
class DirectRpc:
    """Ratios of cubics from normalised (sample, line, height) to normalised (lon, lat).

    Twenty coefficients each, RPC00B order with the sample in the place of the longitude and
    the line in the place of the latitude. The normalisation is that of the `RpcModel` which
    carries it. `fit_error_m` is the maker's precision along (x, y), where the file states it.
    """

    lon_num: FloatArray
    lon_den: FloatArray
    lat_num: FloatArray
    lat_den: FloatArray
    fit_error_m: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("lon_num", "lon_den", "lat_num", "lat_den"):
            object.__setattr__(self, name, twenty(getattr(self, name), name))

    def normalised_ground(
        self, line: FloatArray, samp: FloatArray, height: FloatArray
    ) -> FloatArray:
        """Normalised (lon, lat) (..., 2) of normalised line, sample and height (...)."""
        terms = cubic_terms(samp, line, height)
        return np.stack(
            [terms @ self.lon_num / (terms @ self.lon_den),
             terms @ self.lat_num / (terms @ self.lat_den)],
            axis=-1,
        )  # fmt: skip


def twenty(values: FloatArray, name: str) -> FloatArray:
    """Return read-only `values` (20), finite; anything else is an `ArgumentError`."""
    array = read_only(values)
    if array.shape != (20,):
        raise ArgumentError(f"{name}: 20 coefficients expected, got {array.size}")
    if not np.all(np.isfinite(array)):
        bad = int(np.argmax(~np.isfinite(array))) + 1
        raise ArgumentError(f"{name}: finite coefficients expected, number {bad} is not")
    return array
