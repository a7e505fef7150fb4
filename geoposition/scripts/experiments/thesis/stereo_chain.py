"""Images and models to control, compensation, ground points and surface, through files.

What the ground believes is written as model files, one pair for each attitude; `adjust`,
`intersect` and `dsm` work from these, as a user's own run would.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude
from geoposition.calib_fields.synthetic_dom import synthetic_image
from geoposition.matching import MatchOptions, match_images, open_image
from geoposition.observations import ControlPoints
from geoposition.scripts import dsm_run
from geoposition.scripts.adjust import run as adjust_run
from geoposition.scripts.experiments.thesis.control import (
    GPS_SIGMA_M,
    IMAGE_SIGMA_PX,
    MOUNTING_PRIOR_ARCSEC,
    Layout,
    measured_models,
)
from geoposition.scripts.experiments.thesis.field import SongshanField
from geoposition.scripts.experiments.thesis.fusion import KINDS, Kind
from geoposition.scripts.experiments.thesis.scene import HEIGHTS_M, Scene
from geoposition.scripts.experiments.thesis.telemetry import Telemetry
from geoposition.scripts.point_tables import write_ground
from geoposition.scripts.results import unseen
from geoposition.scripts.stereo import run as stereo_run
from geoposition.scripts.tables import whole_file
from geoposition.scripts.tie_tables import read_checks, read_ties, write_ties
from geoposition.sensors.readers import open_product
from geoposition.sensors.writers.model_file import write_model_file

GREY_NOISE: Final = 2.0
GREY_SCALE: Final = 8.0
DSM_M: Final = 7.0
MATCHING: Final = MatchOptions(heights_m=HEIGHTS_M, tile_px=384, max_tiles=16, tile_features=1500)
"""Some thousand ties are plenty."""
REPORTED: Final[Kind] = "fused"
"""The adjustment with a report of its own; the others' figures are in their adjustment.json."""
_MISSING: Final = 0

_IMAGE: Final = '[[image]]\nid = "{name}"\nproduct = "models/{kind}/{name}.toml"\n\n'
_RUN: Final = """\
# Ten of the 42 points compensate the attitude of each image, the others check. T 5.3.2.
{images}[control]
file = "gcps.csv"
image_points = "gcps_px.csv"
sigma_m = {gps}
image_sigma_px = {sigma_px}

[check]
ids = {check}

[[unknown]]
kind = "attitude_bias"
degree = 0
sigma_arcsec = {prior}

[robust]
enabled = false               # no blunders among these marks, and raw attitude is all scatter

[output]
csm = false
report = {report}
"""


@dataclass(frozen=True, slots=True, eq=False)
class StereoChain:
    """Figures of `adjust` by attitude, of `intersect` and of `dsm`."""

    adjustments: Mapping[Kind, Mapping[str, Any]]
    intersection: Mapping[str, Any]
    surface: Mapping[str, Any]

    def as_json(self) -> dict[str, Any]:
        """Figures by name."""
        return {
            "checkpoint_rmse_m": {
                **{kind: facts["check_rmse_m"] for kind, facts in self.adjustments.items()},
                "before": {
                    kind: facts["check_rmse_before_m"] for kind, facts in self.adjustments.items()
                },
                "predicted": {
                    kind: facts["predicted_check_rmse_m"]
                    for kind, facts in self.adjustments.items()
                },
            },
            "adjust": {
                kind: {"control": facts["control"], "check": facts["check"]}
                for kind, facts in self.adjustments.items()
            },
            "intersect": {
                name: self.intersection[name]
                for name in ("matches", "intersected", "residual_px", "rmse_m", "height_m")
                if name in self.intersection
            },
            "dsm": {
                name: self.surface[name]
                for name in ("crs", "resolution", "shape", "points", "matched_share", "comparison")
            },
        }


def run_stereo(
    scene: Scene,
    field: SongshanField,
    telemetry: Telemetry,
    attitudes: Mapping[Kind, Attitude],
    marks: ControlPoints,
    seed: int,
    step: Callable[[], None],
) -> StereoChain:
    """Render, write what the ground has, compensate, intersect, make the surface."""
    folder = field.folder
    for number, (name, model) in enumerate(scene.models.items()):
        grey = synthetic_image(
            model,
            field.terrain,
            field.dom,
            noise=GREY_NOISE * GREY_SCALE,
            gain=GREY_SCALE,
            seed=seed + number,
        )
        _write_image(folder / f"{name}.tif", grey)
        step()
    write_models(scene, telemetry, attitudes, folder)
    write_control(folder, marks, list(scene.models))
    adjustments: dict[Kind, dict[str, Any]] = {}
    for kind in KINDS:
        path = folder / f"RUN-{kind}.toml"
        path.write_text(_run_text(scene, field.plan, kind), encoding="utf-8")
        adjustments[kind] = dict(adjust_run.run(path, folder / "adjusted" / kind, unseen))
        step()
    paths = [folder / "adjusted" / "fused" / f"{name}.toml" for name in scene.models]
    products = [open_product(path) for path in paths]
    images = [folder / f"{name}.tif" for name in scene.models]
    sources = [open_image(path) for path in images]
    matches = match_images(sources, [product.model for product in products], MATCHING)
    assert marks.image is not None
    write_ties(folder / "ties.csv", [matches, marks.image], list(scene.models))
    step()
    ties = read_ties(folder / "ties.csv", paths)
    options = stereo_run.Options(sigma_px=None, checks=read_checks(folder / "gcps.csv"))
    stereo = stereo_run.intersect(products, ties, options, unseen)
    stereo_run.write(folder / "points.csv", stereo)
    step()
    request = dsm_run.Request(folder / "dsm.tif", resolution=DSM_M, reference=folder / "dem.tif")
    surface = dsm_run.run(products, images, request, unseen)
    step()
    return StereoChain(adjustments, stereo.summary, surface)


def write_models(
    scene: Scene, telemetry: Telemetry, attitudes: Mapping[Kind, Attitude], folder: Path
) -> None:
    """Write models/KIND/NAME.toml as the ground has them, and the truth."""
    for kind in KINDS:
        place = folder / "models" / kind
        place.mkdir(parents=True, exist_ok=True)
        models = measured_models(scene, telemetry, attitudes[kind])
        for name, model in zip(scene.models, models, strict=True):
            write_model_file(
                model,
                place / f"{name}.toml",
                sensor=f"simulated ZY-3, {name} camera, {kind} attitude",
                image=folder / f"{name}.tif",
            )
    truth = folder / "truth"
    truth.mkdir(exist_ok=True)
    for name, model in scene.models.items():
        sensor = f"simulated ZY-3, {name} camera, the truth"
        write_model_file(model, truth / f"{name}.toml", sensor=sensor, image=folder / f"{name}.tif")


def write_control(folder: Path, points: ControlPoints, names: list[str]) -> None:
    """Write gcps.csv, id,lon,lat,height, and gcps_px.csv, id,product,row,col."""
    write_ground(folder / "gcps.csv", points.ids, points.geodetic)
    assert points.image is not None
    write_ties(folder / "gcps_px.csv", [points.image], names)


def _run_text(scene: Scene, plan: Layout, kind: Kind) -> str:
    quoted = ", ".join(f'"{name}"' for name in plan.check_ids)
    return _RUN.format(
        images="".join(_IMAGE.format(name=name, kind=kind) for name in scene.models),
        gps=GPS_SIGMA_M,
        sigma_px=IMAGE_SIGMA_PX,
        check=f"[{quoted}]",
        prior=MOUNTING_PRIOR_ARCSEC,
        report=str(kind == REPORTED).lower(),
    )


def _write_image(path: Path, grey: FloatArray) -> None:
    band = np.where(np.isfinite(grey), np.clip(np.rint(grey), 1, 4095), _MISSING)
    with warnings.catch_warnings(), whole_file(path) as temporary:
        # An image as taken has no map coordinates.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(
            temporary,
            "w",
            driver="GTiff",
            dtype="uint16",
            count=1,
            height=band.shape[0],
            width=band.shape[1],
            tiled=True,
            compress="deflate",
            nodata=_MISSING,
        ) as file:
            file.write(band.astype(np.uint16), 1)
