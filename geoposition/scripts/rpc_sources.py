"""What an RPC can be fitted to, on the command line: products, location grids, control points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.errors import ArgumentError, GeometryError, GeopositionError, ProductError
from geoposition.flags import has_result
from geoposition.rpc.fit import fit_model, fit_samples, refuse_beyond
from geoposition.rpc.fit_build import RpcFit
from geoposition.rpc.fit_check import Misfit
from geoposition.rpc.fit_control import fit_control
from geoposition.rpc.fit_solve import Denominators
from geoposition.rpc.model import RpcModel
from geoposition.scripts.results import Progress
from geoposition.scripts.tables import PARQUET_SUFFIXES, read_table
from geoposition.sensor_model import SensorModel
from geoposition.sensors.readers import open_product
from geoposition.sensors.readers.location_grid import LocationGrid, read_location_grid
from geoposition.terrain.raster import RasterTerrain

_TABLES = {".csv", *PARQUET_SUFFIXES}
_BORDER = 11
_MARGIN_M = 50.0


@dataclass(frozen=True, slots=True)
class Options:
    """The command's options, as given."""

    heights_m: tuple[float, float] | None
    dem: Path | None
    geoid: Path | None
    degree: int
    denominators: Denominators
    direct: bool
    limit_px: float


@dataclass(frozen=True, slots=True, eq=False)
class SourceFit:
    """A fit, its RPC ready to be written, and its facts by name."""

    fit: RpcFit
    model: RpcModel
    source: str
    facts: Mapping[str, object]


def fit(path: Path, options: Options, progress: Progress) -> SourceFit:
    """Fit to whatever `path` is."""
    if path.suffix.lower() in _TABLES:
        return _fit_table(path, options)
    grid = _location_grid(path)
    if grid is not None:
        return _fit_grid(path, grid, options)
    product = open_product(path)
    progress(1, 4)
    heights, origin = _heights(product.model, options)
    progress(2, 4)
    try:
        found = fit_model(
            product.model,
            heights,
            degree=options.degree,
            denominators=options.denominators,
            direct=options.direct,
            limit_px=options.limit_px,
        )
    except GeometryError as error:
        raise GeometryError(f"{path}: {error}") from None
    progress(3, 4)
    name = "" if product.sensor == "unknown" else product.sensor
    model = replace(found.model, satellite=name)
    source = f"{'rigorous model' if product.is_rigorous else 'RPC'} ({product.format})"
    facts = {"source": source, "heights": origin, **found.as_dict()}
    return SourceFit(found, model, source, facts)


def _heights(model: SensorModel, options: Options) -> tuple[tuple[float, float] | None, str]:
    if options.heights_m is not None:
        return options.heights_m, "as given"
    if options.dem is None:
        return None, "the model's range"
    terrain = RasterTerrain(options.dem, options.geoid)
    lines, samples = model.shape
    border = np.stack(
        np.meshgrid(
            np.linspace(-0.5, lines - 0.5, _BORDER), np.linspace(-0.5, samples - 0.5, _BORDER),
            indexing="ij",
        ),
        axis=-1,
    )  # fmt: skip
    ground = model.image_to_ground(
        np.stack([border, border]), np.array(model.height_range_m)[:, None, None]
    )
    low, high = terrain.height_range_m(ground.geodetic[has_result(ground.flag)])
    if not (np.isfinite(low) and np.isfinite(high)):
        raise ProductError(options.dem, "", "heights under the image expected, it has none there")
    return (low - _MARGIN_M, high + _MARGIN_M), f"the DEM's under the image, and {_MARGIN_M:g} m"


def _location_grid(path: Path) -> LocationGrid | None:
    """Return the location grid in `path`, or None where it is something else."""
    if path.suffix.lower() not in (".tif", ".tiff") or not path.is_file():
        return None
    try:
        return read_location_grid(path)
    except GeopositionError:
        return None


def _fit_grid(path: Path, grid: LocationGrid, options: Options) -> SourceFit:
    _refuse_heights(options, "a location grid has its own heights")
    if min(len(grid.lines_px), len(grid.samples_px)) < 8 or len(grid.height_m) < options.degree + 1:
        raise ProductError(
            path, "nodes", f"8 lines, 8 samples, {options.degree + 1} heights expected at least"
        )
    image = np.broadcast_to(grid.image_px, (len(grid.height_m), *grid.image_px.shape))
    used = np.zeros(image.shape[:-1], dtype=bool)
    used[:, ::2, ::2] = True
    used[:, -1, ::2] = used[:, ::2, -1] = used[:, -1, -1] = True
    settings = {"degree": options.degree, "denominators": options.denominators}
    half = fit_samples(image[used], grid.geodetic[used], direct=False, **settings)  # type: ignore[arg-type]
    kept = half.model.ground_to_image(grid.geodetic[~used])
    misfit = kept.image_px - image[~used]
    good = has_result(kept.flag)
    rows, cols = Misfit.of(misfit[good][:, 0]), Misfit.of(misfit[good][:, 1])
    refuse_beyond(options.limit_px, max(rows.max, cols.max), half.region)
    found = fit_samples(image, grid.geodetic, direct=options.direct, **settings)  # type: ignore[arg-type]
    facts = {
        "source": "location grid",
        **found.as_dict(),
        "kept_out": {"points": int(good.sum()), "row": rows.as_dict(), "col": cols.as_dict()},
    }
    return SourceFit(found, found.model, "location grid", facts)


def _fit_table(path: Path, options: Options) -> SourceFit:
    _refuse_heights(options, "control points have their own heights")
    columns = ("row", "col", "lon", "lat", "height")
    table = read_table(path, columns, optional=("sigma_px",))
    values = np.stack([np.asarray(table[name], dtype=np.float64) for name in columns], axis=1)
    good = np.isfinite(values).all(axis=1)
    sigma: FloatArray | None = None
    if "sigma_px" in table:
        sigma = np.asarray(table["sigma_px"], dtype=np.float64)[good]
    found = fit_control(
        values[good, :2],
        values[good, 2:] * (np.radians(1.0), np.radians(1.0), 1.0),
        sigma,
        degree=options.degree,
        denominators=options.denominators,
    )
    alone = found.leave_one_out_px
    rows, cols = Misfit.of(alone[:, 0]), Misfit.of(alone[:, 1])
    facts = {
        "source": "control points",
        **found.fit.as_dict(),
        "leave_one_out": {"row": rows.as_dict(), "col": cols.as_dict()},
        "unreadable": int((~good).sum()),
    }
    return SourceFit(found.fit, found.fit.model, "control points", facts)


def _refuse_heights(options: Options, why: str) -> None:
    if options.heights_m is not None or options.dem is not None:
        raise ArgumentError(f"--heights, --dem: {why}")
