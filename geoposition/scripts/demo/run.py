"""What `geoposition demo` computes: a simulated three-line scene, then the library at work on it.

Nothing here knows the truth but the simulation and the comparison: triangulation, location and
residuals see models, tie points and a DEM file, as a user's own run would.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from geoposition.accuracy import (
    PointStatistics,
    enu_errors_m,
    normalised_rms,
    point_statistics,
)
from geoposition.arrays import FloatArray, IntArray
from geoposition.calib_fields.synthetic import SyntheticTerrain, synthetic_terrain
from geoposition.flags import Flag, has_result
from geoposition.locate import locate
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts.demo.data import (
    DemoOptions,
    DemoResult,
    Intersection,
    Measured,
    Models,
)
from geoposition.scripts.demo.sanity import sensitivity
from geoposition.scripts.results import Progress
from geoposition.sensors.simulate import (
    SimulatedScene,
    simulate_measurements,
    simulate_scene,
)
from geoposition.terrain.raster import RasterTerrain
from geoposition.triangulate import IntersectedPoints, triangulate

_TERRAIN_MARGIN_M: Final = 4000.0
_EDGE_POINTS: Final = 40
_STEPS: Final = 12


def run_demo(options: DemoOptions, dem_path: Path, progress: Progress) -> DemoResult:
    """Simulate, write the DEM to `dem_path`, measure, intersect, locate, compare."""
    steps = iter(range(_STEPS + 1))

    def step() -> None:
        progress(next(steps), _STEPS)

    step()
    scene = simulate_scene(options.scene, options.seed)
    step()
    terrain = _terrain(options, scene)
    terrain.write(dem_path)
    dem = RasterTerrain(dem_path)
    step()
    outlines = {name: _outline(model, dem) for name, model in scene.true.items()}
    step()
    rng = np.random.default_rng(np.random.SeedSequence(options.seed).spawn(5)[4])
    check = _check_points(options, scene, dem, rng)
    step()
    grid, index, shape, extent = _grid_points(options, scene, dem, outlines, rng)
    step()
    true = _intersection(scene.true, check, options)
    step()
    measured = _intersection(scene.measured, check, options)
    step()
    budget = _budget(scene, check, options, true, measured)
    step()
    height_true = triangulate(list(scene.true.values()), grid.ties(), options.image_sigma_px)
    step()
    height_measured = triangulate(
        list(scene.measured.values()), grid.ties(), options.image_sigma_px
    )
    step()
    residuals = {
        name: check.image_px[name] - model.ground_to_image(check.geodetic).image_px
        for name, model in scene.measured.items()
    }
    single = {
        name: point_statistics(locate(model, check.image_px[name], dem).geodetic, check.geodetic)
        for name, model in scene.measured.items()
    }
    step()
    one_arcsecond = sensitivity(scene, check, options)
    step()
    return DemoResult(
        options=options,
        scene=scene,
        terrain=terrain,
        outlines=outlines,
        check=check,
        grid=grid,
        grid_index=index,
        grid_shape=shape,
        grid_extent_deg=extent,
        true=true,
        measured=measured,
        budget=budget,
        residuals_px=residuals,
        height_true=height_true,
        height_measured=height_measured,
        height_error_true_m=_above(height_true, dem),
        height_error_measured_m=_above(height_measured, dem),
        single=single,
        sensitivity=one_arcsecond,
    )


def _border(shape: tuple[int, int]) -> FloatArray:
    """Image points around the outermost pixels' edges, closed."""
    lines, samples = shape[0] - 0.5, shape[1] - 0.5
    part = np.linspace(0.0, 1.0, _EDGE_POINTS, endpoint=False)
    zero, one = np.zeros(_EDGE_POINTS), np.ones(_EDGE_POINTS)
    row = np.concatenate([zero, part, one, 1.0 - part, [0.0]])
    col = np.concatenate([part, one, 1.0 - part, zero, [0.0]])
    return np.stack([row * (lines + 0.5) - 0.5, col * (samples + 0.5) - 0.5], axis=1)


def _outline(model: PushbroomModel, dem: RasterTerrain) -> FloatArray:
    """Footprint on the terrain, (n, 2) longitude and latitude in degrees, closed."""
    ground = locate(model, _border(model.shape), dem)
    return np.degrees(ground.geodetic[has_result(ground.flag), :2])


def _terrain(options: DemoOptions, scene: SimulatedScene) -> SyntheticTerrain:
    """Terrain that holds all footprints, whatever their heights, and a margin."""
    low, high = options.scene.height_range_m
    corners = [
        model.image_to_ground(_border(model.shape), height).geodetic
        for model in scene.true.values()
        for height in (low, high)
    ]
    ground = np.concatenate(corners)[:, :2]
    west, south = ground.min(axis=0)
    east, north = ground.max(axis=0)
    middle = 0.5 * (west + east), 0.5 * (south + north)
    radius = 6.371e6
    return synthetic_terrain(
        float(middle[0]),
        float(middle[1]),
        float((east - west) * np.cos(middle[1]) * radius) + 2.0 * _TERRAIN_MARGIN_M,
        float((north - south) * radius) + 2.0 * _TERRAIN_MARGIN_M,
        seed=options.seed,
        lowest_m=low,
        highest_m=high,
    )


def _measure(
    scene: SimulatedScene,
    geodetic: FloatArray,
    prefix: str,
    options: DemoOptions,
    rng: np.random.Generator,
) -> tuple[Measured, IntArray]:
    """Project through the true models with noise; keep points that all images show."""
    image = {
        name: simulate_measurements(model, geodetic, options.image_sigma_px, rng)[0]
        for name, model in scene.true.items()
    }
    seen = np.all([np.isfinite(px).all(axis=1) for px in image.values()], axis=0)
    kept = np.flatnonzero(seen & np.isfinite(geodetic).all(axis=1))
    ids = np.array([f"{prefix}{k:05d}" for k in kept], dtype=np.str_)
    return Measured(ids, geodetic[kept], {name: px[kept] for name, px in image.items()}), kept


def _check_points(
    options: DemoOptions, scene: SimulatedScene, dem: RasterTerrain, rng: np.random.Generator
) -> Measured:
    """Points strewn over the nadir image, on the terrain."""
    nadir = scene.true["nadir"]
    size = np.array(nadir.shape, dtype=np.float64)
    pixels = rng.uniform(0.01, 0.99, (options.check_points, 2)) * size
    ground = locate(nadir, pixels, dem)
    return _measure(scene, ground.geodetic[ground.flag == Flag.OK], "c", options, rng)[0]


def _grid_points(
    options: DemoOptions,
    scene: SimulatedScene,
    dem: RasterTerrain,
    outlines: Mapping[str, FloatArray],
    rng: np.random.Generator,
) -> tuple[
    Measured,
    IntArray,
    tuple[int, int],
    tuple[float, float, float, float],
]:
    """Points on a north-up lattice over the nadir image, as dense matching would give them."""
    west, south = outlines["nadir"].min(axis=0)
    east, north = outlines["nadir"].max(axis=0)
    width = (east - west) * np.cos(np.radians(0.5 * (south + north)))
    rows = options.grid
    cols = max(2, round(rows * float(width / (north - south))))
    lon = west + (np.arange(cols) + 0.5) / cols * (east - west)
    lat = north - (np.arange(rows) + 0.5) / rows * (north - south)
    places = np.radians(np.stack(np.meshgrid(lon, lat), axis=-1).reshape(-1, 2))
    height = dem.height_at(places).height_m
    points, kept = _measure(scene, np.column_stack([places, height]), "g", options, rng)
    extent = (float(west), float(east), float(south), float(north))
    return points, kept.astype(np.int64), (rows, cols), extent


def _intersection(models: Models, points: Measured, options: DemoOptions) -> Intersection:
    found = triangulate(list(models.values()), points.ties(), options.image_sigma_px)
    statistics = point_statistics(found.geodetic, points.geodetic)
    errors = enu_errors_m(found.geodetic, points.geodetic)
    sigma = found.sigma_enu_m
    normalised = {axis: normalised_rms(errors[:, k], sigma[:, k]) for k, axis in enumerate("enu")}
    return Intersection(found, statistics, normalised)


def _budget(
    scene: SimulatedScene,
    points: Measured,
    options: DemoOptions,
    true: Intersection,
    measured: Intersection,
) -> dict[str, PointStatistics]:
    """Check-point errors with one cause at a time, then with all."""

    def with_one(ephemeris: bool, attitude: bool, mounting: bool) -> PointStatistics:
        models = {
            name: PushbroomModel(
                (scene.measured if mounting else scene.true)[name].camera,
                scene.measured_ephemeris if ephemeris else scene.true_ephemeris,
                scene.measured_attitude if attitude else scene.true_attitude,
                model.corrections,
                model.height_range_m,
            )
            for name, model in scene.true.items()
        }
        return _intersection(models, points, options).statistics

    return {
        "image points": true.statistics,
        "orbit": with_one(True, False, False),
        "attitude noise": with_one(False, True, False),
        "mounting": with_one(False, False, True),
        "all": measured.statistics,
    }


def _above(found: IntersectedPoints, dem: RasterTerrain) -> FloatArray:
    """Heights found less the DEM's at the same place, NaN where there is none."""
    ground = dem.height_at(found.geodetic)
    result: FloatArray = found.geodetic[:, 2] - ground.height_m
    return result
