"""The ground's height: constant, analytic, or raster; and where lines of sight meet it first."""

from geoposition.terrain.raster import RasterTerrain
from geoposition.terrain.surfaces import (
    AnalyticTerrain,
    ConstantTerrain,
    Crossings,
    Terrain,
    TerrainHeights,
)

__all__ = [
    "AnalyticTerrain",
    "ConstantTerrain",
    "Crossings",
    "RasterTerrain",
    "Terrain",
    "TerrainHeights",
]
