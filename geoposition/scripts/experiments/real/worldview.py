"""The WorldView-2 pair: product, model, simulated control, adjustment, intersection, RPC."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from geoposition.accuracy import enu_errors_m
from geoposition.arrays import FloatArray
from geoposition.errors import ProductError
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.compare import Comparison
from geoposition.rpc.formats import write_rpc
from geoposition.scripts import rpc_compare_run, rpc_report, rpc_sources
from geoposition.scripts.adjust import run as adjust_run
from geoposition.scripts.experiments.real.repeats import Repeats, repeat
from geoposition.scripts.experiments.real.size import Size
from geoposition.scripts.experiments.real.survey import (
    BIAS_ARCSEC,
    GPS_SIGMA_M,
    IMAGE_SIGMA_PX,
    KNOWN_SIGMA_M,
    Survey,
    attitude_left_arcsec,
    planted,
    survey,
)
from geoposition.scripts.point_tables import write_ground
from geoposition.scripts.results import unseen
from geoposition.scripts.stereo import run as stereo_run
from geoposition.scripts.stereo.errors import StatedSigmas
from geoposition.scripts.tie_tables import read_checks, read_ties, write_ties
from geoposition.sensors.readers import open_product
from geoposition.sensors.writers.model_file import write_model_file

STEPS: Final = 6
"""Steps of the chain beside its repetitions."""
PROFILE: Final = (301, 5, 2)
"""Grid on which differences are drawn along the lines."""
_RPC_LIMIT_PX: Final = 1.0

_IMAGE: Final = '[[image]]\nid = "{name}"\nproduct = "working/{name}.toml"\n\n'
_RUN: Final = """\
# The working models follow the control; the kept-out reference checks. All marks are in ties.csv.
{images}[control]
file = "gcps.csv"
sigma_m = {gps}
image_sigma_px = {sigma_px}

[ties]
file = "ties.csv"
sigma_px = {sigma_px}

[check]
file = "reference.csv"

[[unknown]]
kind = "attitude_bias"
degree = 0

[output]
csm = false
report = {report}
"""

STAGES: Final[Mapping[str, tuple[str, str]]] = {
    "before": ("working", ".toml"),
    "after": ("adjusted", ".toml"),
    "reference": ("reference", ".toml"),
    "vendor": ("vendor", ".RPB"),
}
"""Models with which the check points are intersected: their folder and their files' ending."""


@dataclass(frozen=True, slots=True, eq=False)
class Intersected:
    """Check points (n) found with one kind of model: true places (n, 3), errors, RMS errors."""

    true: FloatArray
    error_enu_m: FloatArray
    rmse_enu_m: Mapping[str, float]
    rmse_m: float
    residual_px: float


@dataclass(frozen=True, slots=True, eq=False)
class Rpcs:
    """One image's RPCs and models, compared: the second named less the first, in pixels."""

    adjusted_vendor: Comparison
    reference_vendor: Comparison
    adjusted_ours: Comparison
    ours_vendor: Comparison
    profile_adjusted: Comparison
    profile_reference: Comparison

    def as_json(self) -> dict[str, Any]:
        """Return the comparisons on the data's grid by name."""
        return {
            "vendor_less_adjusted": self.adjusted_vendor.as_dict(),
            "vendor_less_reference": self.reference_vendor.as_dict(),
            "ours_less_adjusted": self.adjusted_ours.as_dict(),
            "vendor_less_ours": self.ours_vendor.as_dict(),
            "not_of_the_row_px": not_of_the_row(self.reference_vendor),
        }


@dataclass(frozen=True, slots=True, eq=False)
class WorldView:
    """What the chain found; `left_arcsec`, `sigma_arcsec` (images, 3) of the attitude."""

    points: Survey
    adjustment: Mapping[str, Any]
    left_arcsec: Mapping[str, list[float]]
    intersected: Mapping[str, Intersected]
    rpcs: Mapping[str, Rpcs]
    repeats: Repeats

    @property
    def sigma_arcsec(self) -> list[float]:
        """Standard deviations of the attitude unknowns, in the images' order."""
        return [float(entry["sigma_arcsec"]) for entry in self.adjustment["parameters"]]

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        facts = self.adjustment
        return {
            "points": {
                "control": len(self.points.control),
                "check": len(self.points.check),
                "ties": len(self.points.ties),
            },
            "planted_arcsec": dict(zip(self.left_arcsec, map(list, BIAS_ARCSEC), strict=True)),
            "attitude_left_arcsec": dict(self.left_arcsec),
            "attitude_sigma_arcsec": self.sigma_arcsec,
            "adjust": {
                name: facts[name]
                for name in (
                    "control_rmse_m", "check_rmse_m", "check_rmse_before_m",
                    "predicted_check_rmse_m", "sigma0", "rejected",
                )
            },
            "check_points": {
                stage: {
                    "rmse_m": dict(found.rmse_enu_m), "rmse_3d_m": found.rmse_m,
                    "residual_px": found.residual_px,
                }
                for stage, found in self.intersected.items()
            },
            "rpc": {name: found.as_json() for name, found in self.rpcs.items()},
            "repeated": self.repeats.as_json(),
        }  # fmt: skip


def not_of_the_row(found: Comparison) -> dict[str, float]:
    """Return the standard deviation of differences about their mean in each row, pixels."""
    rest = found.difference_px - found.profile_px[:, None, :]
    deviation = np.nanstd(rest.reshape(-1, 2), axis=0)
    return {"row": float(deviation[0]), "col": float(deviation[1])}


def run_worldview(
    files: Mapping[str, Path], folder: Path, size: Size, seed: int, step: Callable[[], None]
) -> WorldView:
    """Run the chain in `folder`; `files` are the two products by name."""
    models: dict[str, PushbroomModel] = {}
    for place in ("reference", "vendor", "working", "rpc"):
        (folder / place).mkdir(parents=True)
    for name, path in files.items():
        product = open_product(path)
        if not isinstance(product.model, PushbroomModel) or product.vendor_rpc is None:
            raise ProductError(path, "", "a product with rigorous model and RPC expected")
        models[name] = product.model
        write_model_file(
            product.model,
            folder / f"reference/{name}.toml",
            sensor=f"{product.sensor}, as delivered",
        )
        write_rpc(product.vendor_rpc, folder / f"vendor/{name}.RPB")
    step()
    points = measure(models, folder, seed)
    _write_run(models, folder, size)
    step()
    facts = adjust_run.run(folder / "RUN.toml", folder / "adjusted", unseen)
    left = {}
    for name, model in models.items():
        adjusted = open_product(folder / f"adjusted/{name}.toml").model
        assert isinstance(adjusted, PushbroomModel)
        left[name] = attitude_left_arcsec(model, adjusted).tolist()
    step()
    intersected = {stage: _intersect(folder, list(models), stage) for stage in STAGES}
    step()
    for name in models:
        _fit(folder, name, size)
    step()
    rpcs = {name: _compare(folder, name) for name in models}
    step()
    repeats = repeat(models, points, size.runs, seed, step)
    return WorldView(points, facts, left, intersected, rpcs, repeats)


def measure(models: Mapping[str, PushbroomModel], folder: Path, seed: int) -> Survey:
    """Plant the bias, measure control and ties, and write in `folder` what the commands take."""
    place, noise = (
        np.random.default_rng(stream) for stream in np.random.SeedSequence([seed, 0]).spawn(2)
    )
    points = survey(list(models.values()), place)
    for name, model in planted(models, noise).items():
        write_model_file(
            model, folder / f"working/{name}.toml", sensor="WorldView-2, attitude spoilt on purpose"
        )
    ids = points.ids
    write_ties(folder / "ties.csv", [points.marks(noise)], list(models))
    write_ground(folder / "gcps.csv", ids[points.control], points.measured(noise), GPS_SIGMA_M)
    check = points.check
    write_ground(folder / "reference.csv", ids[check], points.geodetic[check], KNOWN_SIGMA_M)
    return points


def _write_run(names: Iterable[str], folder: Path, size: Size) -> None:
    text = _RUN.format(
        images="".join(_IMAGE.format(name=name) for name in names),
        gps=GPS_SIGMA_M,
        sigma_px=IMAGE_SIGMA_PX,
        report=str(size.reports).lower(),
    )
    (folder / "RUN.toml").write_text(text, encoding="utf-8")


def _intersect(folder: Path, names: list[str], stage: str) -> Intersected:
    """Intersect all marks with one kind of model; the check points' errors."""
    place, ending = STAGES[stage]
    paths = [folder / place / f"{name}{ending}" for name in names]
    options = stereo_run.Options(
        sigma_px=IMAGE_SIGMA_PX,
        stated=StatedSigmas(image_only=True),
        checks=read_checks(folder / "reference.csv"),
    )
    products = [open_product(path) for path in paths]
    run = stereo_run.intersect(products, read_ties(folder / "ties.csv", paths), options, unseen)
    stereo_run.write(folder / f"points-{stage}.csv", run)
    assert run.checks is not None
    rows, true, found = run.checks.rows, run.checks.true, run.checks.statistics
    return Intersected(
        true,
        enu_errors_m(run.points.geodetic[rows], true),
        {axis: found.axes[axis].rmse for axis in "enu"},
        found.rmse_3d_m,
        float(np.nanmedian(run.points.residual_px)),
    )


def _fit(folder: Path, name: str, size: Size) -> None:
    product, output = folder / f"adjusted/{name}.toml", folder / f"rpc/{name}.RPB"
    options = rpc_sources.Options(None, None, None, 3, "separate", True, _RPC_LIMIT_PX)
    fit = rpc_sources.fit(product, options, unseen)
    write_rpc(fit.model, output)
    if size.reports:
        rpc_report.write(output.with_suffix(".html"), product.name, output.name, fit, fit.facts)


def _compare(folder: Path, name: str) -> Rpcs:
    adjusted, reference = folder / f"adjusted/{name}.toml", folder / f"reference/{name}.toml"
    vendor, ours = folder / f"vendor/{name}.RPB", folder / f"rpc/{name}.RPB"
    compared = rpc_compare_run.run
    return Rpcs(
        adjusted_vendor=compared(adjusted, vendor)[0],
        reference_vendor=compared(reference, vendor)[0],
        adjusted_ours=compared(adjusted, ours)[0],
        ours_vendor=compared(ours, vendor)[0],
        profile_adjusted=compared(adjusted, vendor, grid=PROFILE)[0],
        profile_reference=compared(reference, vendor, grid=PROFILE)[0],
    )
