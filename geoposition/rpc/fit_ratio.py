"""RPC polynomials of normalised variables from a well-conditioned fit of others.

Ground to image is fitted in variables in which points fill the cube: the affine functions of
the ground nearest to line and sample, and the height. An oblique look, a strip across the
meridians or a tiny crop under high relief then are as well conditioned as anything. An affine
change of variables takes cubics to cubics, so nothing is lost on the way back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.rpc.fit_basis import substitution
from geoposition.rpc.fit_columns import affine_parts
from geoposition.rpc.fit_solve import FitOptions, Ratios, fit_ratios

_TERMS = 20


@dataclass(frozen=True, slots=True)
class Fitted:
    """RPC00B coefficients of two ratios: `num` and `den` (2, 20), den[:, 0] = 1.

    `covariance` (2, 39, 39) is of num and den[1:]; `ratios` is the fit behind.
    """

    num: FloatArray
    den: FloatArray
    covariance: FloatArray
    ratios: Ratios


def fit_inverse(
    ground: FloatArray,
    image: FloatArray,
    unit: FloatArray,
    options: FitOptions,
    weight: FloatArray | None = None,
) -> Fitted:
    """Fit normalised (line, sample) (2, n) to normalised (lon, lat, height) (3, n)."""
    flat = np.ones(ground.shape[1]) if weight is None else weight
    affine = affine_parts(ground, image, flat)
    matrix = np.array([affine[0, 1:], affine[1, 1:], [0.0, 0.0, 1.0]])
    return _fit(ground, image, matrix, unit, options, weight)


def fit_direct(
    image: FloatArray, ground: FloatArray, unit: FloatArray, options: FitOptions
) -> Fitted:
    """Fit normalised (lon, lat) (2, n) to normalised (sample, line, height) (3, n)."""
    return _fit(image, ground, np.eye(3), unit, options, None)


def _fit(
    variables: FloatArray,
    target: FloatArray,
    matrix: FloatArray,
    unit: FloatArray,
    options: FitOptions,
    weight: FloatArray | None,
) -> Fitted:
    x = matrix @ variables
    low, high = x.min(axis=1), x.max(axis=1)
    half = np.maximum(0.5 * (high - low), 1e-9)
    x -= (0.5 * (low + high))[:, None]
    x /= half[:, None]
    matrix, shift = matrix / half[:, None], -0.5 * (low + high) / half
    ratios = fit_ratios(x, np.ascontiguousarray(target), unit, options, weight)
    back = substitution(matrix, shift)
    num, den = ratios.num @ back.T, ratios.den @ back.T
    covariance = np.empty((2, 2 * _TERMS - 1, 2 * _TERMS - 1))
    both = np.zeros((2 * _TERMS, 2 * _TERMS))
    both[:_TERMS, :_TERMS] = both[_TERMS:, _TERMS:] = back
    keep = np.delete(np.arange(2 * _TERMS), _TERMS)
    for i in range(2):
        # Dividing by the denominator's constant couples every coefficient to it.
        whole = np.concatenate([num[i], den[i]]) / den[i, 0]
        divide = np.eye(2 * _TERMS)
        divide[:, _TERMS] -= whole
        to = (divide / den[i, 0])[keep] @ both
        covariance[i] = to @ ratios.covariance[i] @ to.T
    return Fitted(num / den[:, :1], den / den[:, :1], covariance, ratios)
