"""Curves through samples: Lagrange, Hermite, cubic spline, polynomial. None extrapolates.

A `Curve` maps times (...) to values (..., k). Outside its span it raises `SpanError`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from geoposition.arrays import FloatArray, read_only, require_finite, require_increasing
from geoposition.errors import ArgumentError, SpanError

_SPAN_TOLERANCE_S = 1e-9
"""Rounding allowed at the ends of a span, far below any line time."""


class Curve(Protocol):
    """A vector-valued function of time with a span."""

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time at which the curve is defined."""
        ...

    @property
    def knots_s(self) -> FloatArray:
        """Times (m,) at which some derivative may jump; empty where the curve is smooth."""
        ...

    def value(self, times_s: ArrayLike) -> FloatArray:
        """Values (..., k) at `times_s` (...)."""
        ...

    def rate(self, times_s: ArrayLike) -> FloatArray:
        """First derivatives (..., k), per second, at `times_s` (...)."""
        ...


def within_span(times_s: ArrayLike, span_s: tuple[float, float], what: str) -> FloatArray:
    """Return `times_s` as an array clipped by rounding only; outside is a `SpanError`."""
    times = np.asarray(times_s, dtype=np.float64)
    if times.size:
        low, high = float(np.min(times)), float(np.max(times))
        if not (low >= span_s[0] - _SPAN_TOLERANCE_S and high <= span_s[1] + _SPAN_TOLERANCE_S):
            raise SpanError(what, (low, high), span_s)
    return np.clip(times, *span_s)


def _samples(times_s: ArrayLike, values: ArrayLike, least: int) -> tuple[FloatArray, FloatArray]:
    times = require_increasing(read_only(times_s), "times")
    table = require_finite(read_only(values), "samples")
    if table.ndim != 2 or len(table) != len(times):
        raise ArgumentError(f"samples: shape ({len(times)}, k) expected, got {table.shape}")
    if len(times) < least:
        raise ArgumentError(f"samples: at least {least} expected, got {len(times)}")
    return times, table


@dataclass(frozen=True, slots=True, eq=False)
class LagrangeCurve:
    """Lagrange polynomial through the `points` samples nearest to the time asked.

    The stencil is centred, and pushed inwards at the ends of the table. With an even number of
    points the curve is continuous; with an odd one it jumps half-way between samples, where the
    stencil moves on. Source: T 2.1.4 (orientation images); DIMAP and CSM products prescribe it
    with 8 points.
    """

    times_s: FloatArray
    values: FloatArray
    points: int = 8

    def __post_init__(self) -> None:
        times, values = _samples(self.times_s, self.values, 2)
        object.__setattr__(self, "times_s", times)
        object.__setattr__(self, "values", values)
        if self.points < 2:
            raise ArgumentError(f"Lagrange points: at least 2 expected, got {self.points}")
        object.__setattr__(self, "points", min(self.points, len(times)))

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last sample time."""
        return float(self.times_s[0]), float(self.times_s[-1])

    @property
    def knots_s(self) -> FloatArray:
        """Where the stencil moves on."""
        if self.points == len(self.times_s):
            return np.empty(0)
        if self.points % 2 == 0:
            return self.times_s
        middles: FloatArray = 0.5 * (self.times_s[1:] + self.times_s[:-1])
        return middles

    def _stencil(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        n, m = len(self.times_s), self.points
        if m % 2 == 0:
            first = np.searchsorted(self.times_s, times, side="right") - m // 2
        else:
            middles = 0.5 * (self.times_s[1:] + self.times_s[:-1])
            first = np.searchsorted(middles, times, side="right") - m // 2
        index = np.clip(first, 0, n - m)[..., None] + np.arange(m)
        return self.times_s[index], self.values[index]

    def value(self, times_s: ArrayLike) -> FloatArray:
        """Values (..., k) at `times_s` (...)."""
        times = within_span(times_s, self.span_s, "interpolation")
        nodes, values = self._stencil(times)
        weights = np.ones(nodes.shape)
        for j in range(self.points):
            for i in range(self.points):
                if i != j:
                    weights[..., j] *= (times - nodes[..., i]) / (nodes[..., j] - nodes[..., i])
        result: FloatArray = np.einsum("...m,...mk->...k", weights, values)
        return result

    def rate(self, times_s: ArrayLike) -> FloatArray:
        """First derivatives (..., k) at `times_s` (...)."""
        times = within_span(times_s, self.span_s, "interpolation")
        nodes, values = self._stencil(times)
        weights = np.zeros(nodes.shape)
        for j in range(self.points):
            for skip in range(self.points):
                if skip == j:
                    continue
                term = 1.0 / (nodes[..., j] - nodes[..., skip])
                for i in range(self.points):
                    if i not in (j, skip):
                        term = term * (times - nodes[..., i]) / (nodes[..., j] - nodes[..., i])
                weights[..., j] += term
        result: FloatArray = np.einsum("...m,...mk->...k", weights, values)
        return result


@dataclass(frozen=True, slots=True, eq=False)
class SplineCurve:
    """Cubic spline through samples (not-a-knot ends), or Hermite where rates are given."""

    times_s: FloatArray
    values: FloatArray
    spline: CubicSpline | CubicHermiteSpline

    @classmethod
    def through(cls, times_s: ArrayLike, values: ArrayLike) -> SplineCurve:
        """Cubic spline through `values` (n, k) at `times_s` (n,), n >= 4."""
        times, table = _samples(times_s, values, 4)
        return cls(times, table, CubicSpline(times, table, axis=0))

    @classmethod
    def hermite(cls, times_s: ArrayLike, values: ArrayLike, rates: ArrayLike) -> SplineCurve:
        """Cubic Hermite curve through `values` (n, k) with first derivatives `rates` (n, k)."""
        times, table = _samples(times_s, values, 2)
        slopes = require_finite(read_only(rates), "rates")
        if slopes.shape != table.shape:
            raise ArgumentError(f"rates: shape {table.shape} expected, got {slopes.shape}")
        return cls(times, table, CubicHermiteSpline(times, table, slopes, axis=0))

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last sample time."""
        return float(self.times_s[0]), float(self.times_s[-1])

    @property
    def knots_s(self) -> FloatArray:
        """The sample times."""
        return self.times_s

    def value(self, times_s: ArrayLike) -> FloatArray:
        """Values (..., k) at `times_s` (...)."""
        result: FloatArray = self.spline(within_span(times_s, self.span_s, "interpolation"))
        return result

    def rate(self, times_s: ArrayLike) -> FloatArray:
        """First derivatives (..., k) at `times_s` (...)."""
        result: FloatArray = self.spline(within_span(times_s, self.span_s, "interpolation"), 1)
        return result


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialCurve:
    """Polynomial in s = (t − offset_s) / scale_s, `coefficients` (degree + 1, k) ascending.

    Source: T 2.7 (any degree; the quadratic is degree 2).
    """

    coefficients: FloatArray
    offset_s: float
    scale_s: float
    span_s: tuple[float, float]

    def __post_init__(self) -> None:
        table = require_finite(read_only(self.coefficients), "coefficients")
        if table.ndim != 2 or not len(table):
            raise ArgumentError(f"coefficients: shape (degree + 1, k) expected, got {table.shape}")
        if not (np.isfinite(self.scale_s) and self.scale_s != 0 and np.isfinite(self.offset_s)):
            raise ArgumentError("polynomial: a finite offset and a scale other than 0 expected")
        if not self.span_s[0] <= self.span_s[1]:
            raise ArgumentError(f"polynomial: a span, first to last, expected, got {self.span_s}")
        object.__setattr__(self, "coefficients", table)

    @classmethod
    def fit(cls, times_s: ArrayLike, values: ArrayLike, degree: int) -> PolynomialCurve:
        """Least-squares polynomial of `degree` through `values` (n, k) at `times_s` (n,)."""
        times, table = _samples(times_s, values, degree + 1)
        offset = 0.5 * (times[0] + times[-1])
        scale = max(0.5 * float(times[-1] - times[0]), 1e-9)
        design = np.vander((times - offset) / scale, degree + 1, increasing=True)
        coefficients = np.linalg.lstsq(design, table, rcond=None)[0]
        return cls(
            read_only(coefficients), float(offset), scale, (float(times[0]), float(times[-1]))
        )

    @property
    def knots_s(self) -> FloatArray:
        """None: a polynomial is smooth."""
        return np.empty(0)

    def _horner(self, times_s: ArrayLike, coefficients: FloatArray) -> FloatArray:
        times = within_span(times_s, self.span_s, "interpolation")
        s = ((times - self.offset_s) / self.scale_s)[..., None]
        value = np.zeros((*times.shape, coefficients.shape[1]))
        for row in coefficients[::-1]:
            value = value * s + row
        return value

    def value(self, times_s: ArrayLike) -> FloatArray:
        """Values (..., k) at `times_s` (...)."""
        return self._horner(times_s, self.coefficients)

    def rate(self, times_s: ArrayLike) -> FloatArray:
        """First derivatives (..., k) at `times_s` (...)."""
        degrees = np.arange(1, len(self.coefficients))[:, None]
        return self._horner(times_s, self.coefficients[1:] * degrees / self.scale_s)


@dataclass(frozen=True, slots=True, eq=False)
class SumCurve:
    """Two curves added, over the span both share."""

    first: Curve
    second: Curve

    @property
    def span_s(self) -> tuple[float, float]:
        """The span both share."""
        (a, b), (c, d) = self.first.span_s, self.second.span_s
        return max(a, c), min(b, d)

    @property
    def knots_s(self) -> FloatArray:
        """The knots of both, inside the shared span."""
        knots = np.union1d(self.first.knots_s, self.second.knots_s)
        low, high = self.span_s
        return knots[(knots >= low) & (knots <= high)]

    def value(self, times_s: ArrayLike) -> FloatArray:
        """Values (..., k) at `times_s` (...)."""
        return self.first.value(times_s) + self.second.value(times_s)

    def rate(self, times_s: ArrayLike) -> FloatArray:
        """First derivatives (..., k) at `times_s` (...)."""
        return self.first.rate(times_s) + self.second.rate(times_s)
