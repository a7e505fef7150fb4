"""What a re-imaging run is asked, and the models that it needs for any of its rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from geoposition.errors import GeometryError, ProductError
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.cog import Compression
from geoposition.reimage.mapping import DEFAULT_BOUND_PX
from geoposition.reimage.raster_files import ImageFile
from geoposition.reimage.resample import Method
from geoposition.reimage.steady import SteadyAttitude, SteadyOptions, steady_model
from geoposition.reimage.strips import STRIP_ROWS, Part, parts_of
from geoposition.reimage.virtual import Segment, ideal_camera
from geoposition.scripts.reimage.input import AttitudeInput, jittered_model
from geoposition.scripts.row_windows import Split
from geoposition.terrain import RasterTerrain, Terrain

_WHOLE: Final[tuple[Segment, ...]] = ()


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of a run."""

    image: Path
    output: Path
    attitude: AttitudeInput | None = None
    dem: Path | None = None
    geoid: Path | None = None
    height_m: float | None = None
    steady: SteadyOptions = field(default_factory=SteadyOptions)
    ideal: bool = False
    method: Method = "cubic"
    bound_px: float = DEFAULT_BOUND_PX
    nodata: float | None = None
    compress: Compression = "zstd"
    strip_rows: int = STRIP_ROWS
    evaluation: Path | None = None
    report: bool = True
    split: Split = field(default_factory=Split)


@dataclass(frozen=True, slots=True, eq=False)
class Models:
    """Models of a run: `own` has the product's camera, `steady` that of the new image."""

    jittered: PushbroomModel
    own: PushbroomModel
    steady: PushbroomModel
    removed: SteadyAttitude
    terrain: Terrain | float
    parts: tuple[Part, ...]


def models_of(product: Product, request: Request, image: ImageFile) -> Models:
    """Make the models that `request` needs, and map the new image to the one there is."""
    jittered = jittered_model(product, image, request.attitude, request.steady.cutoff_hz)
    own, removed = steady_model(jittered, request.steady)
    steady, segments = own, _WHOLE
    if request.ideal:
        camera, segments = ideal_camera(own.camera)
        steady = replace(own, camera=camera)
    terrain = _terrain(product, request, jittered)
    parts = _parts(steady, jittered, terrain, segments, request)
    return Models(jittered, own, steady, removed, terrain, parts)


def _parts(
    steady: PushbroomModel,
    jittered: PushbroomModel,
    terrain: Terrain | float,
    segments: Sequence[Segment],
    request: Request,
) -> tuple[Part, ...]:
    try:
        return parts_of(steady, jittered, terrain, segments, request.bound_px)
    except GeometryError as error:
        if request.dem is None:
            raise
        raise ProductError(request.dem, "", f"heights under the image expected ({error})") from None


def _terrain(product: Product, request: Request, model: PushbroomModel) -> Terrain | float:
    if request.dem is not None:
        return RasterTerrain(request.dem, request.geoid)
    if request.height_m is not None:
        return request.height_m
    if product.vendor_rpc is not None:
        return float(product.vendor_rpc.height_off_m)
    return 0.5 * (model.height_range_m[0] + model.height_range_m[1])
