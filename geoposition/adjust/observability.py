"""What the measurements determine, and what rests on the priors.

With C the covariance of the unknowns in units of the prior, an eigenvalue c of C belongs to a
combination of which the measurements took the share 1 − c of the prior variance. Combinations
with next to nothing taken are not determined: an attitude bias beside the mounting of the only
camera, look angles without points across the row, roll from one point only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from geoposition.adjust.adjustment import WeakCombination
from geoposition.arrays import FloatArray

WEAK_GAIN: Final = 0.5
"""A combination whose variance was not halved is called weak."""
CORRELATED: Final = 0.95
_LEAST_PART: Final = 0.2
_MOST_PAIRS: Final = 50


def weak_combinations(names: Sequence[str], covariance_z: FloatArray) -> list[WeakCombination]:
    """Find combinations of unknowns that rest on their priors, the weakest first."""
    if not len(names):
        return []
    values, vectors = np.linalg.eigh(covariance_z)
    out = []
    for k in np.argsort(-values):
        gain = 1.0 - float(values[k])
        if gain >= WEAK_GAIN:
            break
        vector = vectors[:, k]
        order = np.argsort(-np.abs(vector))
        order = order[np.abs(vector[order]) >= _LEAST_PART * abs(vector[order[0]])]
        sign = np.sign(vector[order[0]])
        parts = tuple((names[i], float(sign * vector[i])) for i in order)
        out.append(WeakCombination(parts, max(gain, 0.0)))
    return out


def correlated_pairs(names: Sequence[str], covariance: FloatArray) -> list[tuple[str, str, float]]:
    """Pairs of unknowns with correlations beyond `CORRELATED`, the closest first."""
    sigma = np.sqrt(np.diagonal(covariance))
    correlation = covariance / np.outer(sigma, sigma)
    i, j = np.nonzero(np.triu(np.abs(correlation) > CORRELATED, 1))
    order = np.argsort(-np.abs(correlation[i, j]))[:_MOST_PAIRS]
    return [(names[i[k]], names[j[k]], float(correlation[i[k], j[k]])) for k in order]
