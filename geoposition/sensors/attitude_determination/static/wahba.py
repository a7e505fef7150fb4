"""The algebra of Wahba's problem: Davenport's matrix, its largest eigenvalue, QUEST's quaternion.

All from attitude profiles B = sum w b r^T (..., 3, 3) whose weights sum to one.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from geoposition.arrays import FloatArray

_NEWTON_STEPS: Final = 20


def davenport_matrix(profile: FloatArray) -> FloatArray:
    """K (..., 4, 4), scalar last, with the loss 1 − q^T K q. *Source*: T (3.11)–(3.13)."""
    trace = np.trace(profile, axis1=-2, axis2=-1)
    matrix = np.empty((*profile.shape[:-2], 4, 4))
    matrix[..., :3, :3] = (
        profile + np.swapaxes(profile, -1, -2) - trace[..., None, None] * np.eye(3)
    )
    matrix[..., :3, 3] = matrix[..., 3, :3] = axial(profile)
    matrix[..., 3, 3] = trace
    return matrix


def axial(profile: FloatArray) -> FloatArray:
    """Vector z = sum w b × r (..., 3). *Source*: T (3.13)."""
    rows, columns = (1, 2, 0), (2, 0, 1)
    result: FloatArray = profile[..., rows, columns] - profile[..., columns, rows]
    return result


def adjugate(matrix: FloatArray) -> FloatArray:
    """Transposed cofactors (..., 3, 3): the inverse times the determinant, singular or not."""
    a, b, c = (matrix[..., k, :] for k in range(3))
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)


def largest_eigenvalue(profile: FloatArray) -> FloatArray:
    """Largest eigenvalue (...) of K by Newton's iteration from above, 1 being its bound.

    *Source*: the quartic of Markley 1993, FOAM: (x^2 − |B|^2)^2 − 8 x det B − 4 |adj B|^2.
    """
    size = np.sum(profile**2, axis=(-2, -1))
    determinant = np.linalg.det(profile)
    cofactors = np.sum(adjugate(profile) ** 2, axis=(-2, -1))
    x = np.ones(profile.shape[:-2])
    for _ in range(_NEWTON_STEPS):
        square = x**2 - size
        slope = 4.0 * (x * square - 2.0 * determinant)
        value = square**2 - 8.0 * x * determinant - 4.0 * cofactors
        # Above the largest root the slope is positive; where rounding leaves none, stay.
        x = x - np.where(slope > 0.0, value / np.where(slope > 0.0, slope, 1.0), 0.0)
    return x


def quest_quaternion(profile: FloatArray, eigenvalue: FloatArray) -> FloatArray:
    """Quaternion (..., 4), not unit, of the `eigenvalue` (...) of K.

    The nearer its turn is to 180 degrees, the smaller it comes out. *Source*: Shuster & Oh 1981,
    (66)–(69).
    """
    symmetric = profile + np.swapaxes(profile, -1, -2)
    sigma = np.trace(profile, axis1=-2, axis2=-1)
    kappa = np.trace(adjugate(symmetric), axis1=-2, axis2=-1)
    alpha = eigenvalue**2 - sigma**2 + kappa
    beta = eigenvalue - sigma
    gamma = (eigenvalue + sigma) * alpha - np.linalg.det(symmetric)
    z = axial(profile)[..., None]
    turned = symmetric @ z
    vector = alpha[..., None, None] * z + beta[..., None, None] * turned + symmetric @ turned
    return np.concatenate([vector[..., 0], gamma[..., None]], axis=-1)
