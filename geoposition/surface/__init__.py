"""Surfaces and point clouds: points to files, and a surface against a reference."""

from geoposition.surface.compare import (
    FEWEST_COMPARED,
    Comparison,
    SurfaceComparison,
    compare_points,
    compare_surface,
)
from geoposition.surface.coregister import Shift
from geoposition.surface.dsm import DsmGrid, Surface, is_geographic
from geoposition.surface.map_extent import map_extent, near_degrees
from geoposition.surface.map_points import to_map
from geoposition.surface.point_cloud import PointCloud

__all__ = [
    "FEWEST_COMPARED",
    "Comparison",
    "DsmGrid",
    "PointCloud",
    "Shift",
    "Surface",
    "SurfaceComparison",
    "compare_points",
    "compare_surface",
    "is_geographic",
    "map_extent",
    "near_degrees",
    "to_map",
]
