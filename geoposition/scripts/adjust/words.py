"""The gist of an adjustment run for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def words(summary: Mapping[str, Any]) -> dict[str, object]:
    """Pick what a reader wants at once; the rest is in adjustment.json and the report."""
    out: dict[str, object] = {}
    if "sigma0" in summary:
        for role in ("control", "check"):
            if summary[f"{role}_rmse_m"] is not None:
                before, after = summary[f"{role}_rmse_before_m"], summary[f"{role}_rmse_m"]
                was = "–" if before is None else f"{before:.3f}"
                out[f"{role} RMSE, m"] = f"{after:.3f} (before {was})"
        if summary["predicted_check_rmse_m"] is not None:
            out["predicted at check points, m"] = f"{summary['predicted_check_rmse_m']:.3f}"
        relative = summary["relative"]
        if relative is not None and "residual_px" in relative["after"]:
            was, now = (
                f"{relative[k]['residual_px']['median']:.3f}" if "residual_px" in relative[k]
                else "–"
                for k in ("before", "after")
            )  # fmt: skip
            out["rays miss by, px (median)"] = f"{now} (before {was})"
        out["sigma0"] = f"{summary['sigma0']:.3f}"
        out["rejected"] = ", ".join(summary["rejected"][:20]) or "none"
        for entry in summary["parameters"][:40]:
            angle = "value_arcsec" in entry
            value = entry["value_arcsec"] if angle else entry["value"]
            sigma = entry["sigma_arcsec"] if angle else entry["sigma"]
            unit = "arcsec" if angle else entry["unit"]
            out[entry["name"]] = f"{value:+.4g} ± {sigma:.2g} {unit}"
        if summary["weak"]:
            out["not determined"] = "\n".join(weak["text"] for weak in summary["weak"][:6])
        if summary["diagnosis"]:
            out["looks as if"] = "\n".join(item["message"] for item in summary["diagnosis"])
    if "plan" in summary:
        points = summary["plan"]["points"]
        out["planned, expected RMSE, m"] = ", ".join(f"{p['expected_rmse_m']:.3f}" for p in points)
    out["files"] = ", ".join(summary["files"])
    return out
