"""New images from old ones: steady re-imaging and orthorectification, and what both share."""

from geoposition.reimage.mapping import RowMap, SourceMapping, map_models
from geoposition.reimage.ortho import OrthoTask, ortho_window
from geoposition.reimage.ortho_grid import OrthoGrid
from geoposition.reimage.resample import METHODS, Method, Resampler
from geoposition.reimage.steady import SteadyAttitude, SteadyOptions, steady_attitude, steady_model
from geoposition.reimage.strips import Part, Strip, displacement_px, parts_of, strips
from geoposition.reimage.virtual import (
    Segment,
    VirtualCamera,
    cropped_model,
    ideal_camera,
    single_ccd,
)

__all__ = [
    "METHODS",
    "Method",
    "OrthoGrid",
    "OrthoTask",
    "Part",
    "Resampler",
    "RowMap",
    "Segment",
    "SourceMapping",
    "SteadyAttitude",
    "SteadyOptions",
    "Strip",
    "VirtualCamera",
    "cropped_model",
    "displacement_px",
    "ideal_camera",
    "map_models",
    "ortho_window",
    "parts_of",
    "single_ccd",
    "steady_attitude",
    "steady_model",
    "strips",
]
