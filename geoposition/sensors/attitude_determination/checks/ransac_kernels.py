"""Kernels of RANSAC: draw, score and refit the polynomial of every window."""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit, prange

from geoposition.arrays import FloatArray, IntArray

_MEDIAN_NORM: Final = 1.5382
"""Median length of a standard normal vector in space."""
_REFITS: Final = 3


@njit(cache=True, error_model="numpy")
def _rotation_vector(p: FloatArray, q: FloatArray, out: FloatArray) -> None:
    """Rotation vector of p⁻¹ q, the short way round."""
    x = p[3] * q[0] - p[0] * q[3] - p[1] * q[2] + p[2] * q[1]
    y = p[3] * q[1] - p[1] * q[3] - p[2] * q[0] + p[0] * q[2]
    z = p[3] * q[2] - p[2] * q[3] - p[0] * q[1] + p[1] * q[0]
    w = p[3] * q[3] + p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    sine = np.sqrt(x * x + y * y + z * z)
    factor = 2.0 if sine < 1e-12 else 2.0 * np.arctan2(sine, w) / sine
    out[0], out[1], out[2] = factor * x, factor * y, factor * z


@njit(cache=True, error_model="numpy")
def _median_reference(quat: FloatArray, first: int, length: int) -> int:
    """Sample with the smallest median angle to the others, of some tried from the middle out."""
    best, best_value = first + length // 2, -1.0
    closeness = np.empty(length)
    tries = min(length, 15)
    for k in range(tries):
        candidate = first + (length // 2 + k * (length // tries)) % length
        for j in range(length):
            dot = 0.0
            for a in range(4):
                dot += quat[candidate, a] * quat[first + j, a]
            closeness[j] = abs(dot)
        value = _middle(closeness)
        if value > best_value:
            best, best_value = candidate, value
    return best


@njit(cache=True, error_model="numpy")
def _middle(values: FloatArray) -> float:
    """Middle one of `values`, whose order is lost (Hoare's selection)."""
    low, high = 0, len(values) - 1
    target = len(values) // 2
    while low < high:
        pivot = values[target]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if j < target:
            low = i
        if target < i:
            high = j
    return float(values[target])


@njit(cache=True, error_model="numpy")
def _solve(
    powers: FloatArray,
    vectors: FloatArray,
    used: FloatArray,
    normal: FloatArray,
    out: FloatArray,
) -> None:
    """Least-squares polynomial through the samples with `used` 1; `normal` is room to work in."""
    terms = powers.shape[1]
    for a in range(terms):
        for b in range(terms + 3):
            normal[a, b] = 0.0
    for j in range(len(used)):
        if used[j] > 0.0:
            for a in range(terms):
                for b in range(terms):
                    normal[a, b] += powers[j, a] * powers[j, b]
                for c in range(3):
                    normal[a, terms + c] += powers[j, a] * vectors[j, c]
    # Elimination with pivots; a singular column gives zero.
    for a in range(terms):
        pivot = a
        for r in range(a + 1, terms):
            if abs(normal[r, a]) > abs(normal[pivot, a]):
                pivot = r
        for b in range(terms + 3):
            normal[a, b], normal[pivot, b] = normal[pivot, b], normal[a, b]
        for r in range(terms):
            if r != a and abs(normal[a, a]) > 1e-300:
                factor = normal[r, a] / normal[a, a]
                for b in range(a, terms + 3):
                    normal[r, b] -= factor * normal[a, b]
    for a in range(terms):
        for c in range(3):
            out[a, c] = normal[a, terms + c] / normal[a, a] if abs(normal[a, a]) > 1e-300 else 0.0


@njit(cache=True, error_model="numpy")
def _residuals(powers: FloatArray, vectors: FloatArray, model: FloatArray, out: FloatArray) -> None:
    for j in range(len(out)):
        total = 0.0
        for c in range(3):
            value = vectors[j, c]
            for a in range(model.shape[0]):
                value -= powers[j, a] * model[a, c]
            total += value * value
        out[j] = np.sqrt(total)


@njit(cache=True, parallel=True, error_model="numpy")
def fit_all(
    times: FloatArray,
    quat: FloatArray,
    weights: FloatArray,
    start: IntArray,
    threshold: float,
    draws: int,
    seed: int,
    reference: FloatArray,
    span: FloatArray,
    coefficients: FloatArray,
    scale: FloatArray,
    residual: FloatArray,
) -> None:
    """Fill `reference` (w, 4), `span` (w, 2: middle, half), `coefficients` and the others."""
    length = residual.shape[1]
    for w in prange(len(start)):
        first = start[w]
        last = first + length - 1
        span[w, 0] = 0.5 * (times[first] + times[last])
        span[w, 1] = max(0.5 * (times[last] - times[first]), 1e-9)
        chosen = _median_reference(quat, first, length)
        for a in range(4):
            reference[w, a] = quat[chosen, a]
        vectors = np.empty((length, 3))
        powers = np.ones((length, coefficients.shape[1]))
        for j in range(length):
            _rotation_vector(reference[w], quat[first + j], vectors[j])
            for c in range(3):
                vectors[j, c] *= weights[c]
            u = (times[first + j] - span[w, 0]) / span[w, 1]
            for a in range(1, powers.shape[1]):
                powers[j, a] = powers[j, a - 1] * u
        # A small generator of its own: the same draws whatever the threads do.
        state = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(first + 1)
        _draw(powers, vectors, draws, state, coefficients[w], residual[w])
        scale[w] = _refit(powers, vectors, threshold, coefficients[w], residual[w])
        for a in range(coefficients.shape[1]):
            for c in range(3):
                coefficients[w, a, c] /= weights[c]


@njit(cache=True, error_model="numpy")
def _draw(
    powers: FloatArray,
    vectors: FloatArray,
    draws: int,
    state: np.uint64,
    best: FloatArray,
    norms: FloatArray,
) -> None:
    """Polynomial `best` through as few samples as fix it, of the smallest median residual."""
    length, terms = powers.shape
    used, normal = np.empty(length), np.empty((terms, terms + 3))
    trial = np.zeros((terms, 3))
    best_median = np.inf
    for _ in range(draws):
        for j in range(length):
            used[j] = 0.0
        count = 0
        while count < terms:
            state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
            pick = int((state >> np.uint64(33)) % np.uint64(length))
            if used[pick] == 0.0:
                used[pick] = 1.0
                count += 1
        _solve(powers, vectors, used, normal, trial)
        _residuals(powers, vectors, trial, norms)
        median = _middle(norms)
        if median < best_median:
            best_median = median
            for a in range(terms):
                for c in range(3):
                    best[a, c] = trial[a, c]


@njit(cache=True, error_model="numpy")
def _refit(
    powers: FloatArray, vectors: FloatArray, threshold: float, best: FloatArray, norms: FloatArray
) -> float:
    """Least squares through the samples that agree with `best`; returns their scatter."""
    length, terms = powers.shape
    used, normal = np.empty(length), np.empty((terms, terms + 3))
    _residuals(powers, vectors, best, norms)
    for j in range(length):
        used[j] = norms[j]
    # A draw through few samples is loose: the median of its residuals is, too.
    sigma = _middle(used) / _MEDIAN_NORM * (1.0 + 5.0 / max(1, length - terms))
    for _ in range(_REFITS):
        count = 0
        for j in range(length):
            used[j] = 1.0 if norms[j] <= threshold * sigma else 0.0
            count += int(used[j])
        if count <= terms:
            break
        _solve(powers, vectors, used, normal, best)
        _residuals(powers, vectors, best, norms)
        total = 0.0
        for j in range(length):
            total += used[j] * norms[j] * norms[j]
        sigma = np.sqrt(total / (3.0 * (count - terms)))
    return float(sigma)
