"""Image points of several models to ground points, and how far the models disagree."""

from geoposition.triangulate.bias import RelativeBias, relative_bias
from geoposition.triangulate.dense import (
    WeightedPairs,
    triangulate_pairs,
    triangulate_pairs_weighted,
)
from geoposition.triangulate.points import IntersectedPoints, triangulate

__all__ = [
    "IntersectedPoints",
    "RelativeBias",
    "WeightedPairs",
    "relative_bias",
    "triangulate",
    "triangulate_pairs",
    "triangulate_pairs_weighted",
]
