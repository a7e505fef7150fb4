"""Polynomials in three variables as coefficient vectors: what the fit computes with.

Monomials are ordered by degree; the first twenty are those of RPC00B, in its order, so that a
cubic's vector is an RPC coefficient vector. Basis functions are products of Legendre polynomials
scaled to unit mean square over the cube ±1: a coefficient is then the root mean square of what
it adds, and the normal equations of points that fill the cube are close to the identity.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray, IntArray

MAX_DEGREE: Final = 8
"""Products of two columns of the fit, each a cubic times an affine function, reach it."""

_RPC00B: Final = (
    (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (2, 0, 0),
    (0, 2, 0), (0, 0, 2), (1, 1, 1), (3, 0, 0), (1, 2, 0), (1, 0, 2), (2, 1, 0), (0, 3, 0),
    (0, 1, 2), (2, 0, 1), (0, 2, 1), (0, 0, 3),
)  # fmt: skip


def _all_exponents() -> tuple[tuple[int, int, int], ...]:
    higher = [e for e in product(range(MAX_DEGREE + 1), repeat=3) if 4 <= sum(e) <= MAX_DEGREE]
    return (*_RPC00B, *sorted(higher, key=lambda e: (sum(e), e)))  # type: ignore[arg-type]


EXPONENTS: Final = _all_exponents()
"""Exponents of each monomial, degree 0 to `MAX_DEGREE`."""

_INDEX: Final = {exponent: i for i, exponent in enumerate(EXPONENTS)}


def count(degree: int) -> int:
    """Return how many monomials have at most `degree`."""
    return (degree + 1) * (degree + 2) * (degree + 3) // 6


@cache
def products(first: int, second: int) -> IntArray:
    """Index (first, second) of the product of each two of the first so many monomials."""
    table = np.array(
        [
            [_INDEX[a[0] + b[0], a[1] + b[1], a[2] + b[2]] for b in EXPONENTS[:second]]
            for a in EXPONENTS[:first]
        ],
        dtype=np.int64,
    )
    table.setflags(write=False)
    return table


@cache
def recipe() -> tuple[IntArray, IntArray]:
    """Earlier monomial and variable whose product each monomial is; (0, 0) for the first."""
    parent, variable = np.zeros(len(EXPONENTS), np.int64), np.zeros(len(EXPONENTS), np.int64)
    for i, exponent in enumerate(EXPONENTS[1:], start=1):
        k = next(k for k in range(3) if exponent[k])
        less = list(exponent)
        less[k] -= 1
        parent[i], variable[i] = _INDEX[less[0], less[1], less[2]], k
    parent.setflags(write=False)
    variable.setflags(write=False)
    return parent, variable


@cache
def legendre(degree: int) -> FloatArray:
    """Basis functions up to `degree` as rows of monomial coefficients, (n, n)."""
    one = [
        {0: 1.0},
        {1: np.sqrt(3.0)},
        {0: -0.5 * np.sqrt(5.0), 2: 1.5 * np.sqrt(5.0)},
        {1: -1.5 * np.sqrt(7.0), 3: 2.5 * np.sqrt(7.0)},
    ]
    size = count(degree)
    rows = np.zeros((size, size))
    for row, (a, b, c) in zip(rows, EXPONENTS, strict=False):
        for (i, x), (j, y), (k, z) in product(one[a].items(), one[b].items(), one[c].items()):
            row[_INDEX[i, j, k]] += x * y * z
    rows.setflags(write=False)
    return rows


def times_affine(rows: FloatArray, affine: FloatArray) -> FloatArray:
    """Polynomials `rows` (m, n) times the function with coefficients `affine` (4)."""
    n = rows.shape[1]
    degree = next(d for d in range(MAX_DEGREE) if count(d) == n)
    out = np.zeros((len(rows), count(degree + 1)))
    table = products(4, n)
    for k in range(4):
        out[:, table[k]] += affine[k] * rows
    return out


def substitution(matrix: FloatArray, shift: FloatArray) -> FloatArray:
    """Matrix (20, 20) that turns a cubic's coefficients in x into those in y, x = M y + s."""
    parent, variable = recipe()
    rows = np.zeros((20, 20))
    rows[0, 0] = 1.0
    for j in range(1, 20):
        k = variable[j]
        affine = np.array([shift[k], *matrix[k]])
        known = rows[parent[j], : count(2)]
        rows[j] = times_affine(known[None], affine)[0]
    return rows.T


def monomials(x: FloatArray, degree: int = 3) -> FloatArray:
    """Monomials (m, n) up to `degree` of `x` (3, n)."""
    parent, variable = recipe()
    out = np.ones((count(degree), x.shape[1]))
    for j in range(1, len(out)):
        np.multiply(out[parent[j]], x[variable[j]], out=out[j])
    return out
