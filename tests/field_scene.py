"""A synthetic field seen by a push-broom camera whose errors are known, for tests."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from scenes import Jitter, Orbit, Scene, build

from geoposition.arrays import FloatArray
from geoposition.calib_fields.geometry import Dom
from geoposition.calib_fields.synthetic import SyntheticTerrain, synthetic_terrain
from geoposition.calib_fields.synthetic_dom import SyntheticDom, synthetic_dom, synthetic_image
from geoposition.datum import utm_epsg
from geoposition.matching import ImageSource, open_image
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.ortho import OrthoGrid
from geoposition.sensors.directions import PolynomialDirections
from geoposition.sensors.line_camera import Ccd
from geoposition.terrain import RasterTerrain

GSD_M = 10.0
ALTITUDE_M = 600e3
LON_RAD, LAT_RAD = 0.2, 0.75
"""The satellite is above it; the latitude is geocentric there, the ground below at `GROUND_LAT`."""
GROUND_LAT_RAD = float(np.arctan(np.tan(LAT_RAD) / (1.0 - 0.00669437999014)))
IFOV_RAD = GSD_M / ALTITUDE_M


def camera_of(samples: int, bow_px: tuple[float, float] = (0.0, 0.0)) -> tuple[Ccd, ...]:
    """One CCD; `bow_px` is how far a cubic displaces its ends along and across the track."""
    half = 0.5 * (samples - 1)
    x = [0.0, 0.0, 0.0, bow_px[0] * IFOV_RAD]
    y = [0.0, half * IFOV_RAD, 0.0, bow_px[1] * IFOV_RAD]
    return (Ccd(samples, PolynomialDirections(x, y, half, half)),)


def scene(
    shape: tuple[int, int],
    *,
    bias_arcsec: tuple[float, float] = (0.0, 0.0),
    bow_px: tuple[float, float] = (0.0, 0.0),
    jitter: tuple[Jitter, ...] = (),
) -> Scene:
    """Scene over the field, turned by roll and pitch of `bias_arcsec`."""
    roll, pitch = (angle / 3600.0 for angle in bias_arcsec)
    return build(
        shape,
        orbit=Orbit.over(LON_RAD, LAT_RAD, ALTITUDE_M),
        gsd_m=GSD_M,
        roll_deg=roll,
        pitch_deg=pitch,
        ccds=camera_of(shape[1], bow_px),
        jitter=jitter,
        attitude="spline",
        height_range_m=(0.0, 1500.0),
    )


@dataclass(frozen=True)
class FieldScene:
    """Files of a synthetic field, an image of it, the model that took it and the believed one."""

    believed: PushbroomModel
    true: PushbroomModel
    ground: SyntheticTerrain
    texture: SyntheticDom
    image_path: Path
    dom_path: Path
    dem_path: Path

    @property
    def dom(self) -> Dom:
        return Dom.open(self.dom_path)

    @property
    def terrain(self) -> RasterTerrain:
        return RasterTerrain(self.dem_path)

    @property
    def source(self) -> ImageSource:
        return open_image(self.image_path, first_pixel=(0, 0))

    def true_error_px(self, ground: FloatArray) -> FloatArray:
        """Observed less modelled place (n, 2) of ground points (n, 3)."""
        seen, modelled = (m.ground_to_image(ground).image_px for m in (self.true, self.believed))
        return seen - modelled


def write_image(path: Path, grey: FloatArray) -> None:
    """Write a raster that is nowhere on Earth, as images are."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(
            path, "w", driver="GTiff", width=grey.shape[1], height=grey.shape[0], count=1,
            dtype="float32", nodata=float("nan"),
        ) as file:  # fmt: skip
            file.write(grey.astype(np.float32), 1)


def make_field(
    folder: Path,
    shape: tuple[int, int],
    true: Scene,
    *,
    noise: float = 0.0,
    seed: int = 0,
    dom_resolution_m: float = GSD_M,
) -> FieldScene:
    """Write terrain, orthophoto and the image of `true`; the believed model knows no error."""
    true_model, believed = true.model(), scene(shape).model()
    extent = 1.25 * np.array(shape) * GSD_M + 6000.0
    ground = synthetic_terrain(
        LON_RAD, GROUND_LAT_RAD, extent[1] + 0.25 * extent[0], extent[0], seed=seed,
        lowest_m=100.0, highest_m=900.0, step_rad=2e-5, shortest_m=2500.0,
    )  # fmt: skip
    dem_path = folder / "dem.tif"
    ground.write(dem_path)
    terrain = RasterTerrain(dem_path)
    crs = f"EPSG:{utm_epsg(LON_RAD, LAT_RAD)}"
    grid = OrthoGrid.around(believed, terrain, crs, dom_resolution_m)
    pad = int(300.0 / dom_resolution_m)
    grid = replace(
        grid,
        left=grid.left - pad * dom_resolution_m,
        top=grid.top + pad * dom_resolution_m,
        shape=(grid.shape[0] + 2 * pad, grid.shape[1] + 2 * pad),
    )
    texture = synthetic_dom(grid, seed)
    dom_path = folder / "dom.tif"
    texture.write(dom_path)
    image_path = folder / "image.tif"
    grey = synthetic_image(true_model, terrain, texture, noise=noise, gain=0.8, offset=12.0)
    write_image(image_path, grey)
    return FieldScene(believed, true_model, ground, texture, image_path, dom_path, dem_path)
