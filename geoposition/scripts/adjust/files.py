"""What an adjustment run writes beside its report: models, tables of points."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from geoposition.adjust import PointResults, Status
from geoposition.adjust.corrected_model import ImageBiasModel
from geoposition.arrays import FloatArray
from geoposition.errors import GeopositionError, ProductError
from geoposition.observations import ControlPoints
from geoposition.pushbroom import PushbroomModel
from geoposition.rpc.fit import fit_model
from geoposition.rpc.formats import write_rpc
from geoposition.rpc.model import RpcModel
from geoposition.scripts.adjust.images import RunImage
from geoposition.scripts.adjust.request import OutputInput
from geoposition.scripts.adjust.solve import RunResult
from geoposition.scripts.tables import Column, write_table
from geoposition.sensor_model import SensorModel
from geoposition.sensors.writers.csm import write_csm
from geoposition.sensors.writers.model_file import write_model_file

_STATUS: Final = np.array([status.name.lower() for status in Status])
_DEGREES: Final = 180.0 / np.pi


def write_models(
    images: tuple[RunImage, ...],
    models: tuple[SensorModel, ...],
    wanted: OutputInput,
    folder: Path,
    home: Path,
) -> list[dict[str, object]]:
    """Write each adjusted model as a product of its own; what could not be written, and why.

    The files will be moved from `folder` to `home`.

    A rigorous model becomes a model file with tables, and a CSM state where its camera allows;
    an RPC a file `ID_RPC.TXT` with the bias in it. With image biases on top a rigorous model can
    only be told as the RPC fitted to it.
    """
    return [
        _written(image, model, wanted, folder, home)
        for image, model in zip(images, models, strict=True)
    ]


def _written(
    image: RunImage, model: SensorModel, wanted: OutputInput, folder: Path, home: Path
) -> dict[str, object]:
    stem = "".join(c if c not in '/\\:"' else "_" for c in image.id)
    files: dict[str, object] = {"id": image.id}
    sensor = "" if image.product.sensor == "unknown" else image.product.sensor
    pixels = image.pixels or image.product.image_path
    if isinstance(model, PushbroomModel):
        place = folder / f"{stem}.toml"
        write_model_file(model, place, sensor=sensor, image=pixels, home=home)
        files["model"] = place.name
        if wanted.csm:
            try:
                picture = "" if pixels is None else pixels.name
                write_csm(model, folder / f"{stem}_csm.json", sensor=sensor, image=picture)
                files["csm"] = f"{stem}_csm.json"
            except GeopositionError as error:
                reason = error.expected if isinstance(error, ProductError) else str(error)
                files["csm_note"] = f"no CSM state: {reason}"
    if isinstance(model, RpcModel):
        files["rpc"] = files["model"] = _rpc(model, folder, stem)
    elif wanted.rpc or isinstance(model, ImageBiasModel):
        fitted = fit_model(model, limit_px=np.inf)
        files["rpc"] = _rpc(fitted.model, folder, stem)
        files["rpc_misfit_px"] = fitted.as_dict()
        files.setdefault("model", files["rpc"])
    return files


def _rpc(model: RpcModel, folder: Path, stem: str) -> str:
    name = f"{stem}_RPC.TXT"
    write_rpc(model, folder / name)
    return name


def write_points(result: RunResult, folder: Path) -> list[str]:
    """Write `points.csv`, a row a point, and `image_points.csv`, a row an image point."""
    done = result.adjustment
    reasons = {(r.role, r.id): r.reason for r in result.rejections}
    sets = (
        ("control", done.control, result.points.control),
        ("check", done.check, result.points.check),
        ("tie", done.ties, None),
    )
    parts = [
        _ground_columns(role, points, given, reasons) for role, points, given in sets if len(points)
    ]
    write_table(folder / "points.csv", _joined(parts))
    ids = np.array([image.id for image in result.images])
    rows = [_image_columns(role, points, ids) for role, points, _ in sets if len(points)]
    write_table(folder / "image_points.csv", _joined(rows))
    return ["points.csv", "image_points.csv"]


def _joined(parts: list[dict[str, Any]]) -> dict[str, Column]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _ground_columns(
    role: str,
    points: PointResults,
    given: ControlPoints | None,
    reasons: dict[tuple[str, str], str],
) -> dict[str, Any]:
    """Give adjusted positions, their sigmas, errors and image residuals before and after."""
    n = len(points)
    sigma = points.sigma_enu_m
    nothing = np.full((n, 3), np.nan)
    known = nothing if given is None else given.geodetic * [_DEGREES, _DEGREES, 1.0]
    before, after = (
        _rms_px(points, rows) for rows in (points.residual_before_px, points.residual_px)
    )
    ids = points.ids.astype(np.str_)
    columns: dict[str, Any] = {
        "id": ids,
        "role": np.full(n, role),
        "flag": _STATUS[points.status],
        "lon": np.round(points.geodetic[:, 0] * _DEGREES, 12),
        "lat": np.round(points.geodetic[:, 1] * _DEGREES, 12),
        "height": np.round(points.geodetic[:, 2], 6),
    }
    columns |= {f"sigma_{axis}": np.round(sigma[:, k], 6) for k, axis in enumerate("enu")}
    columns |= {f"given_{name}": known[:, k] for k, name in enumerate(("lon", "lat", "height"))}
    for name, errors in (
        ("before", points.error_before_enu_m), ("after", points.error_enu_m),
    ):  # fmt: skip
        columns |= {f"error_{a}_{name}": np.round(errors[:, k], 6) for k, a in enumerate("enu")}
    columns |= {
        "residual_before_px": np.round(before, 6),
        "residual_after_px": np.round(after, 6),
        "rays": np.bincount(points.point, minlength=n),
        "statistic": np.round(points.statistic, 6),
        "limit": np.where(np.isfinite(points.limit), np.round(points.limit, 6), np.nan),
        "redundancy": np.round(points.redundancy, 6),
        "reason": np.array([reasons.get((role, str(i)), "") for i in ids.tolist()], dtype=np.str_),
    }
    return columns


def _image_columns(role: str, points: PointResults, ids: Column) -> dict[str, Any]:
    """Each image point with its residual, observed less projected, before and after."""
    return {
        "id": points.ids.astype(np.str_)[points.point],
        "role": np.full(len(points.product), role),
        "flag": _STATUS[points.status][points.point],
        "product": ids[points.product],
        "row": points.image_px[:, 0],
        "col": points.image_px[:, 1],
        "residual_row_before_px": np.round(points.residual_before_px[:, 0], 6),
        "residual_col_before_px": np.round(points.residual_before_px[:, 1], 6),
        "residual_row_px": np.round(points.residual_px[:, 0], 6),
        "residual_col_px": np.round(points.residual_px[:, 1], 6),
    }


def _rms_px(points: PointResults, residual_px: FloatArray) -> FloatArray:
    """Root mean square over a point's images of the size of its residuals (n)."""
    size = np.sum(residual_px**2, axis=1)
    good = np.isfinite(size)
    n = len(points)
    total = np.bincount(points.point[good], size[good], minlength=n)
    count = np.bincount(points.point[good], minlength=n)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return np.asarray(np.sqrt(mean))
