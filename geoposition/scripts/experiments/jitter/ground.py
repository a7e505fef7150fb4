"""The fields' folders: DEM, orthophoto and `field.toml`, one for all images of a field."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.calib_fields.field import FIELD_FILE
from geoposition.calib_fields.synthetic import synthetic_terrain
from geoposition.calib_fields.synthetic_strip import (
    footprint,
    lattice_around,
    write_strip_dom,
)
from geoposition.calib_fields.synthetic_texture import EndlessTexture
from geoposition.constants import WGS84_A_M
from geoposition.datum import utm_epsg
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.ortho import OrthoGrid
from geoposition.scripts.experiments.jitter.cases import PIXEL_M, Case
from geoposition.terrain import ConstantTerrain, RasterTerrain
from geoposition.terrain.surfaces import Terrain

DOM_M: Final = 1.0
"""Twice the image's pixel: a match finds what is off by ten pixels of the image."""
DOM_SIGMA_M: Final = 0.0

_DEM_RAD: Final = float(np.radians(0.5 / 3600.0))
_DEM_SHORTEST_M: Final = 400.0
_DEM_MARGIN_M: Final = 2500.0
_DOM_MARGIN_M: Final = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """A field's files, and the texture that its orthophoto and its images are taken of.

    The texture lies on the pixels of `grid`, as large as the images'.
    """

    folder: Path
    terrain: Terrain
    grid: OrthoGrid
    texture: EndlessTexture

    @property
    def dem(self) -> Path:
        """Ellipsoidal heights."""
        return self.folder / "dem.tif"

    @property
    def dom(self) -> Path:
        """The reference orthophoto."""
        return self.folder / "dom.tif"


def make_ground(
    folder: Path,
    cases: Sequence[Case],
    models: Sequence[PushbroomModel],
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> Ground:
    """Make the field that the `models` of its `cases` see, with its files, in `folder`."""
    folder.mkdir(parents=True)
    case = cases[0]
    low, high = case.relief_m
    middle = ConstantTerrain(0.5 * (low + high))
    rough = np.concatenate([footprint(model, middle) for model in models])
    centre, width_m, height_m = _box(rough)
    terrain = synthetic_terrain(
        centre[0], centre[1], width_m, height_m,
        seed=seed, lowest_m=low, highest_m=high, step_rad=_DEM_RAD, shortest_m=_DEM_SHORTEST_M,
    )  # fmt: skip
    terrain.write(folder / "dem.tif")
    ground = RasterTerrain(folder / "dem.tif")
    outlines = [footprint(model, ground) for model in models]
    crs = f"EPSG:{utm_epsg(centre[0], centre[1])}"
    grid = lattice_around(outlines, crs, PIXEL_M, _DOM_MARGIN_M)
    texture = EndlessTexture.of(seed)
    write_strip_dom(
        folder / "dom.tif", grid, texture, outlines, _DOM_MARGIN_M,
        factor=round(DOM_M / PIXEL_M), progress=progress,
    )  # fmt: skip
    _describe(folder / FIELD_FILE, case, np.concatenate(outlines), crs)
    return Ground(folder, ground, grid, texture)


def _box(outline: FloatArray) -> tuple[tuple[float, float], float, float]:
    """Middle (lon, lat) of an outline (n, 3), and width and height of the DEM around it."""
    low, high = outline[:, :2].min(axis=0), outline[:, :2].max(axis=0)
    centre = 0.5 * (low + high)
    size = WGS84_A_M * (high - low) * np.array([np.cos(centre[1]), 1.0]) + 2.0 * _DEM_MARGIN_M
    return (float(centre[0]), float(centre[1])), float(size[0]), float(size[1])


def _describe(path: Path, case: Case, outline: FloatArray, crs: str) -> None:
    low, high = (np.degrees(f(outline[:, :2], axis=0)) for f in (np.min, np.max))
    path.write_text(
        f"""name = "{case.published.region}"
epoch = "{case.published.date[:4]}"
licence = "synthetic: made by geoposition experiment jitter"
plane_datum = "{crs}"
height_datum = "ellipsoid"
remarks = "no measurement: a fractal landscape and texture at the place of that field"

[extent]
west = {low[0]:.6f}
south = {low[1]:.6f}
east = {high[0]:.6f}
north = {high[1]:.6f}

[dom]
files = ["dom.tif"]
resolution_m = {DOM_M}
sigma_m = {DOM_SIGMA_M}

[dem]
files = ["dem.tif"]
sigma_m = 0.0
""",
        encoding="utf-8",
    )
