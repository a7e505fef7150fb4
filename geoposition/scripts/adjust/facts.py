"""The figures of an adjustment run by name, fit for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from geoposition.accuracy import PointStatistics, axis_statistics, point_statistics
from geoposition.adjust import Adjustment, PointResults, Status
from geoposition.adjust.unknowns import ARCSEC_RAD
from geoposition.arrays import FloatArray
from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.observations import ControlPoints
from geoposition.scripts.adjust.relative import image_change_px, relative_facts
from geoposition.scripts.adjust.solve import LeftOut, RunResult

_ROLES: Final = ("control", "check", "ties")


def facts_of(result: RunResult) -> dict[str, object]:
    """All figures; the keys of the contract first."""
    done = result.adjustment
    return {
        "control_rmse_m": rmse_or_none(done.control),
        "check_rmse_m": rmse_or_none(done.check),
        "rejected": [rejection.id for rejection in result.rejections],
        "sigma0": done.sigma0,
        "redundancy": done.redundancy,
        "iterations": len(done.history),
        "images": [_image(result, k) for k in range(len(result.images))],
        "control": points_of(done.control, result.points.control),
        "check": points_of(done.check, result.points.check),
        "ties": _ties(done.ties),
        "control_rmse_before_m": rmse_or_none(done.control, before=True),
        "check_rmse_before_m": rmse_or_none(done.check, before=True),
        "predicted_check_rmse_m": predicted_rmse_m(done.check, result.points.check),
        "scale": dict(done.scale),
        "parameters": parameters(done),
        "weak": [
            {"parts": dict(weak.parts), "gain": weak.gain, "text": str(weak)} for weak in done.weak
        ],
        "correlated": [
            {"names": [a, b], "correlation": value} for a, b, value in done.correlated
        ],
        "diagnosis": [
            {"name": f.name, "message": f.message, "cost": f.cost, "cost_mended": f.cost_mended}
            for f in result.findings
        ],
        "rejections": [
            {
                "id": r.id, "role": r.role, "statistic": r.statistic, "limit": r.limit,
                "residual_px": r.residual_px, "reason": r.reason,
            }
            for r in result.rejections
        ],
        "relative": relative_facts(result),
        "leave_one_out": None if result.left_out is None else left_out_facts(result),
        "height_rounds": result.height_rounds,
    }  # fmt: skip


def rmse_or_none(points: PointResults, *, before: bool = False) -> float | None:
    """Root mean square distance in space; None without points."""
    value = points.rmse_m(before=before)
    return value if np.isfinite(value) else None


def kept(points: PointResults) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Points that took part or checked, and came out."""
    good = (points.status == Status.USED) | (points.status == Status.CHECK)
    return np.asarray(good & np.isfinite(points.error_enu_m[:, 0]))


def statistics_of(
    points: PointResults, given: ControlPoints, *, before: bool = False
) -> PointStatistics | None:
    """Errors of control or check points that were kept, by axis; None without any."""
    good = kept(points)
    if not good.any():
        return None
    errors = points.error_before_enu_m if before else points.error_enu_m
    true = given.geodetic[good]
    moved = np.einsum("nij,nj->ni", enu_axes(true), errors[good])
    if not np.isfinite(moved).any():
        return None
    return point_statistics(ecef_to_geodetic(geodetic_to_ecef(true) + moved), true)


def points_of(points: PointResults, given: ControlPoints | None) -> dict[str, object] | None:
    """Count points; errors on the ground and in the images before and after."""
    if given is None:
        return None
    after, before = statistics_of(points, given), statistics_of(points, given, before=True)
    return {
        "points": len(points),
        "used": int(np.sum(points.status <= Status.CHECK) - np.sum(points.status == 1)),
        "rejected": int(np.sum(points.status == Status.REJECTED)),
        "unusable": [str(i) for i in points.ids[points.status == Status.UNUSABLE].tolist()],
        "rmse_m": _enu(points.rmse_enu_m()),
        "rmse_before_m": _enu(points.rmse_enu_m(before=True)),
        "after": None if after is None else after.as_dict(),
        "before": None if before is None else before.as_dict(),
        "predicted_m": _enu(predicted_enu_m(points, given)),
        "residual_px": residuals_px(points),
    }


def _enu(values: FloatArray) -> dict[str, float]:
    return {axis: float(value) for axis, value in zip("enu", values, strict=True)}


def predicted_enu_m(points: PointResults, given: ControlPoints | None) -> FloatArray:
    """Root mean square errors east, north, up (3) that the covariances predict.

    Those of the intersected points and, for check points, which are independent of them, of the
    given positions. A point in one image has no error of its own in height.
    """
    good = kept(points)
    if given is None or not good.any():
        return np.full(3, np.nan)
    variance = points.sigma_enu_m[good] ** 2 + given.sigma_enu_m[good] ** 2
    single = seen_once(points)[good]
    if single.all():
        return np.append(np.sqrt(np.nanmean(variance[:, :2], axis=0)), np.nan)
    up = np.sqrt(np.nanmean(variance[~single, 2]))
    return np.append(np.sqrt(np.nanmean(variance[:, :2], axis=0)), up)


def seen_once(points: PointResults) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Points (n) in one image only: they keep their given height."""
    return np.asarray(np.bincount(points.point, minlength=len(points)) == 1)


def predicted_rmse_m(points: PointResults, given: ControlPoints | None) -> float | None:
    """Return the same in space; None without points."""
    value = float(np.sqrt(np.nansum(predicted_enu_m(points, given) ** 2)))
    return value if value > 0.0 else None


def residuals_px(points: PointResults) -> dict[str, object]:
    """Image residuals of kept points by row and col, before and after: mean, RMS, and sizes."""
    good = (points.status == Status.USED) | (points.status == Status.CHECK)
    rows = good[points.point]
    return {
        "before": spread_px(points.residual_before_px[rows]),
        "after": spread_px(points.residual_px[rows]),
    }


def spread_px(residual_px: FloatArray) -> dict[str, object] | None:
    """Mean and RMS of row and col, median and largest size; None without residuals."""
    good = residual_px[np.isfinite(residual_px).all(axis=1)]
    if not len(good):
        return None
    size = np.hypot(good[:, 0], good[:, 1])
    names = ("row", "col")
    return {
        "count": len(good),
        "mean": dict(zip(names, good.mean(axis=0).tolist(), strict=True)),
        "rms": dict(zip(names, np.sqrt(np.mean(good**2, axis=0)).tolist(), strict=True)),
        "median": float(np.median(size)),
        "max": float(size.max()),
    }


def _ties(points: PointResults) -> dict[str, object] | None:
    if not len(points):
        return None
    return {
        "points": len(points),
        "used": int(np.sum(points.status == Status.USED)),
        "rejected": int(np.sum(points.status == Status.REJECTED)),
        "unusable": int(np.sum(points.status == Status.UNUSABLE)),
        "residual_px": residuals_px(points),
    }


def parameters(done: Adjustment) -> list[dict[str, object]]:
    """Every unknown with its sigma, in its own unit; angles in arcsec beside it."""
    out: list[dict[str, object]] = []
    sigma, gain = done.sigma, done.gain
    for i, (name, unit) in enumerate(zip(done.names, done.units, strict=True)):
        entry: dict[str, object] = {
            "name": name,
            "value": float(done.values[i]),
            "sigma": float(sigma[i]),
            "unit": unit,
            "prior_sigma": float(done.prior_sigma[i]),
            "gain": float(gain[i]),
        }
        if unit == "rad":
            entry["value_arcsec"] = float(done.values[i] / ARCSEC_RAD)
            entry["sigma_arcsec"] = float(sigma[i] / ARCSEC_RAD)
        out.append(entry)
    return out


def _image(result: RunResult, k: int) -> dict[str, object]:
    """One image: its model, how far its image points moved, residuals by role."""
    image, done = result.images[k], result.adjustment
    roles = {}
    for role, points in zip(_ROLES, (done.control, done.check, done.ties), strict=True):
        mine = (points.product == k) & ((points.status == 0) | (points.status == 2))[points.point]
        if np.any(mine):
            roles[role] = {
                "before": spread_px(points.residual_before_px[mine]),
                "after": spread_px(points.residual_px[mine]),
            }
    moved = image_change_px(image.model, done.models[k])
    return {
        "id": image.id,
        "product": str(image.product.path),
        "model": "rigorous" if image.is_rigorous else "rpc",
        "sensor": image.product.sensor,
        "held": not any(k in block.images for block in result.blocks),
        "change_px": {"row": float(moved[0]), "col": float(moved[1])},
        "residual_px": roles,
    }


def left_out_facts(result: RunResult) -> Mapping[str, Any]:
    """Say what each control point makes of an adjustment by all others."""
    out: LeftOut | None = result.left_out
    assert out is not None
    ids = [image.id for image in result.images]
    rows = [
        {
            "id": out.ids[out.point[i]],
            "image": ids[out.product[i]],
            "row": float(out.residual_px[i, 0]),
            "col": float(out.residual_px[i, 1]),
        }
        for i in range(len(out.point))
    ]
    ground = [
        {"id": name, **_enu(error)} for name, error in zip(out.ids, out.error_enu_m, strict=True)
    ]
    known = out.error_enu_m[np.isfinite(out.error_enu_m).all(axis=1)]
    return {
        "residual_px": spread_px(out.residual_px),
        "rmse_m": _enu(np.sqrt(np.mean(known**2, axis=0))) if len(known) else None,
        "up": axis_statistics(known[:, 2]).as_dict() if len(known) else None,
        "points": rows,
        "errors_m": ground,
    }
