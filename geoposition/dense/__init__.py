"""Dense matching: every pixel of the first image to a ground point, streamed by tiles."""

from geoposition.dense.disparity_to_points import DensePoints
from geoposition.dense.height_field import HeightField, level_field, terrain_field
from geoposition.dense.pair_tile import View
from geoposition.dense.pipeline import DenseOptions, Tally, coarse_surface, dense_points
from geoposition.dense.shifted import ShiftedModel, mutual_shifts_px, shifted_models

__all__ = [
    "DenseOptions",
    "DensePoints",
    "HeightField",
    "ShiftedModel",
    "Tally",
    "View",
    "coarse_surface",
    "dense_points",
    "level_field",
    "mutual_shifts_px",
    "shifted_models",
    "terrain_field",
]
