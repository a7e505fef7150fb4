"""A synthetic calibration field at Songshan: orthophoto, DEM, field.toml, control; their files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.calib_fields.synthetic import synthetic_terrain
from geoposition.calib_fields.synthetic_dom import SyntheticDom, synthetic_dom
from geoposition.datum import to_crs
from geoposition.errors import GeometryError
from geoposition.flags import has_result
from geoposition.reimage.ortho import OrthoGrid
from geoposition.scripts.experiments.thesis.control import POINTS, Layout, layout
from geoposition.scripts.experiments.thesis.scene import HEIGHTS_M, Scene, common_ground
from geoposition.scripts.tables import whole_file
from geoposition.terrain import RasterTerrain

CRS: Final = "EPSG:32649"
DOM_M: Final = 3.0
DEM_STEP_RAD: Final = float(np.radians(1.0 / 3600.0))
SHORTEST_M: Final = 600.0
"""Shortest wave of the ground: some hundred pixels, as of mountains seen from space."""

_MARGIN_M: Final = 400.0
_EDGE: Final = 21
_TOML: Final = """\
name = "Songshan (synthetic)"
epoch = "2012-02"
licence = "made by geoposition from a seed; free of rights"
plane_datum = "{crs}"
height_datum = "ellipsoid"
remarks = "fractal ground and texture within the extent of the Songshan field"

[dom]
files = ["dom.tif"]
sigma_m = 0.01

[dem]
files = ["dem.tif"]
sigma_m = 0.01

[gcps]
file = "gcps.csv"
"""


@dataclass(frozen=True, slots=True, eq=False)
class SongshanField:
    """The field as made; `terrain` is read back from its file."""

    folder: Path
    dom: SyntheticDom
    terrain: RasterTerrain
    plan: Layout


def make_field(scene: Scene, folder: Path, seed: int) -> SongshanField:
    """Make and write the field below all images of `scene`: dom.tif, dem.tif, field.toml."""
    corners = _corners(scene)
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    middle = 0.5 * (low + high)
    place = to_crs(CRS, corners)[:, :2]
    west, south = place.min(axis=0) - _MARGIN_M
    east, north = place.max(axis=0) + _MARGIN_M
    # The map's grid is turned a little against meridians: half as much again holds it.
    ground = synthetic_terrain(
        float(middle[0]),
        float(middle[1]),
        1.3 * float(east - west),
        1.3 * float(north - south),
        seed=seed,
        lowest_m=HEIGHTS_M[0],
        highest_m=HEIGHTS_M[1],
        step_rad=DEM_STEP_RAD,
        shortest_m=SHORTEST_M,
    )
    with whole_file(folder / "dem.tif") as temporary:
        ground.write(temporary)
    shape = round(float(north - south) / DOM_M), round(float(east - west) / DOM_M)
    dom = synthetic_dom(OrthoGrid(CRS, float(west), float(north), DOM_M, shape), seed + 1)
    with whole_file(folder / "dom.tif") as temporary:
        dom.write(temporary)
    (folder / "field.toml").write_text(_TOML.format(crs=CRS), encoding="utf-8")
    terrain = RasterTerrain(folder / "dem.tif")
    points = _on_ground(scene, terrain, np.random.default_rng([seed, 2]))
    return SongshanField(folder, dom, terrain, layout(scene, points))


def _corners(scene: Scene) -> FloatArray:
    """Ground (n, 3) along the borders of all images, at the lowest and highest heights."""
    found = []
    for model in scene.models.values():
        lines, samples = model.shape
        rows, cols = np.linspace(-0.5, lines - 0.5, _EDGE), np.linspace(-0.5, samples - 0.5, _EDGE)
        image = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
        found += [model.image_to_ground(image, height).geodetic for height in HEIGHTS_M]
    return np.concatenate(found)


def _on_ground(scene: Scene, terrain: RasterTerrain, rng: np.random.Generator) -> FloatArray:
    """Points (n, 3) on the terrain that all images show."""
    ground = common_ground(scene, 2 * POINTS, rng)
    heights = terrain.height_at(ground)
    ground = np.column_stack([ground[:, :2], heights.height_m])[has_result(heights.flag)]
    inside = np.ones(len(ground), dtype=np.bool_)
    for model in scene.models.values():
        image = model.ground_to_image(ground).image_px
        edge = 0.02 * min(model.shape)
        inside &= np.all((image > edge) & (image < np.array(model.shape) - edge), axis=1)
    if inside.sum() < POINTS:
        raise GeometryError(f"field: {POINTS} points on the ground that all images show expected")
    return ground[inside][:POINTS]
