"""Synthetic ground texture without end: the same grey value at a place, however it is asked for.

Three layers as `synthetic_dom` has them (a fractal, parcels of even brightness, grain), each a
periodic tile; their periods have no common factor, so that the sum repeats itself nowhere on a
scene. Each tile is the coefficients of a periodic cubic spline: an orthophoto has the spline's
values at its pixels, an image those between them, and neither is ever wholly in memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy import fft, ndimage

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError

Float32Array = NDArray[np.float32]

_PERIODS: Final = (2003, 1499, 1021)
"""Pixels of the layers' tiles; primes, so that no two of them fit together."""
_SPREADS: Final = (4, 1, 1)
"""Pixels of the ground that a pixel of each layer spans: the first one is the landscape."""
_WEIGHTS: Final = (1.0, 0.8, 0.5)
_PARCEL_PX: Final = 24
_SHORTEST_PX: Final = 3.0
_MEAN: Final = 0.5
_CONTRAST: Final = 0.12
_FAST: Final = {"contract", "nsz"}


@dataclass(frozen=True, slots=True, eq=False)
class EndlessTexture:
    """Brightness from 0 to 1, mostly, over a lattice of pixels that has no edge.

    `tiles` are spline coefficients (n + 3, n + 3) of the layers, the last three rows and columns
    of each again its first; `spreads` how many pixels of the lattice a pixel of a tile spans.
    """

    tiles: tuple[Float32Array, ...]
    spreads: tuple[int, ...]

    @classmethod
    def of(cls, seed: int = 0) -> EndlessTexture:
        """Make the layers; the same seed gives the same texture to the last bit."""
        streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)]
        layers = (
            _noise(_PERIODS[0], 2.4, streams[0]),
            _parcels(_PERIODS[1], streams[1]),
            _noise(_PERIODS[2], 0.6, streams[2]),
        )
        scale = _CONTRAST / float(np.hypot.reduce(_WEIGHTS))
        tiles = []
        for k, (layer, weight) in enumerate(zip(layers, _WEIGHTS, strict=True)):
            level = (layer - layer.mean()) / layer.std() * weight * scale
            level += _MEAN if k == 0 else 0.0
            tile = ndimage.spline_filter(level, 3, mode="grid-wrap").astype(np.float32)
            tile = np.pad(tile, (0, 3), mode="wrap")
            tile.setflags(write=False)
            tiles.append(tile)
        return cls(tuple(tiles), _SPREADS)

    def pixels(self, row: int, col: int, rows: int, cols: int) -> Float32Array:
        """Brightness (rows, cols) of the lattice's pixels from (`row`, `col`) on."""
        line = np.broadcast_to(np.arange(row, row + rows, dtype=np.float64)[:, None], (rows, cols))
        sample = np.broadcast_to(np.arange(col, col + cols, dtype=np.float64), (rows, cols))
        return self.at(np.ascontiguousarray(line), np.ascontiguousarray(sample))

    def at(self, row: FloatArray, col: FloatArray) -> Float32Array:
        """Brightness (rows, cols) at fractional pixels of the lattice; NaN where these are."""
        if row.shape != col.shape or row.ndim != 2:
            raise ArgumentError("texture: two arrays of rows and columns, alike in shape, expected")
        out = np.zeros(row.shape, dtype=np.float32)
        for tile, spread in zip(self.tiles, self.spreads, strict=True):
            _add_spline(tile, 1.0 / spread, row, col, out)
        return out


def _noise(period: int, roughness: float, rng: np.random.Generator) -> FloatArray:
    """Periodic random field whose power falls as wave number to −`roughness`."""
    k = np.hypot(fft.fftfreq(period)[:, None], fft.rfftfreq(period)[None, :])
    amplitude = np.maximum(k, 1.0 / period) ** (-0.5 * roughness)
    amplitude *= np.exp(-((k * _SHORTEST_PX) ** 4))
    amplitude[0, 0] = 0.0
    spectrum = fft.rfft2(rng.standard_normal((period, period)))
    field: FloatArray = fft.irfft2(spectrum * amplitude, s=(period, period))
    return field


def _parcels(period: int, rng: np.random.Generator) -> FloatArray:
    """Areas of even brightness around scattered points, their edges softened; periodic."""
    count = period * period // _PARCEL_PX**2
    pad = 4 * _PARCEL_PX
    seeds = np.zeros((period, period), dtype=np.bool_)
    seeds[rng.integers(0, period, count), rng.integers(0, period, count)] = True
    wrapped = np.pad(seeds, pad, mode="wrap")
    _, nearest = ndimage.distance_transform_edt(~wrapped, return_indices=True)
    inner = np.s_[pad : pad + period]
    row, col = ((part[inner, inner] - pad) % period for part in nearest)
    value = rng.standard_normal((period, period))
    soft: FloatArray = ndimage.gaussian_filter(value[row, col], 1.1, mode="wrap")
    return soft


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _add_spline(
    tile: Float32Array, scale: float, row: FloatArray, col: FloatArray, out: Float32Array
) -> None:
    """Add the values of the periodic cubic spline with coefficients `tile` to `out`.

    The tile is given with three rows and columns more, which repeat its first ones.
    """
    n = tile.shape[0] - 3
    size = float(n)
    for i in prange(out.shape[0]):
        for j in range(out.shape[1]):
            y, x = row[i, j] * scale - 1.0, col[i, j] * scale - 1.0
            y -= size * math.floor(y / size)
            x -= size * math.floor(x / size)
            if not (y >= 0.0 and x >= 0.0):
                out[i, j] = np.float32(np.nan)
                continue
            r, c = min(int(y), n - 1), min(int(x), n - 1)
            a0, a1, a2, a3 = _weights(np.float32(y - r))
            b0, b1, b2, b3 = _weights(np.float32(x - c))
            l0, l1, l2, l3 = tile[r], tile[r + 1], tile[r + 2], tile[r + 3]
            out[i, j] += (
                a0 * (b0 * l0[c] + b1 * l0[c + 1] + b2 * l0[c + 2] + b3 * l0[c + 3])
                + a1 * (b0 * l1[c] + b1 * l1[c + 1] + b2 * l1[c + 2] + b3 * l1[c + 3])
                + a2 * (b0 * l2[c] + b1 * l2[c + 1] + b2 * l2[c + 2] + b3 * l2[c + 3])
                + a3 * (b0 * l3[c] + b1 * l3[c + 1] + b2 * l3[c + 2] + b3 * l3[c + 3])
            )


@njit(cache=True, error_model="numpy", inline="always")
def _weights(f: Any) -> Any:
    """Weights of the coefficients at −1, 0, 1, 2 for a place `f` from 0 to 1, 32-bit."""
    g = np.float32(1.0) - f
    sixth = np.float32(1.0 / 6.0)
    two, three, four = np.float32(2.0), np.float32(3.0), np.float32(4.0)
    w1 = (four - three * f * f * (two - f)) * sixth
    w2 = (four - three * g * g * (two - g)) * sixth
    return g * g * g * sixth, w1, w2, f * f * f * sixth
