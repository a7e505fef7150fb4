"""What a re-imaging run says of itself, as plain numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.reimage.sinusoids import Sinusoid, amplitude_spectrum
from geoposition.reimage.steady import SteadyAttitude
from geoposition.reimage.strips import Part
from geoposition.rpc.fit_build import RpcFit
from geoposition.scripts.reimage.jitter import line_facts
from geoposition.terrain import Terrain

_ARCSEC_RAD: Final = float(np.pi / 648000.0)
_AXES: Final = ("roll", "pitch", "yaw")


def height_error(
    parts: Sequence[Part], terrain: Terrain | float, heights: tuple[float, float]
) -> list[float]:
    """Error, (row, col) px, of one height for all at the range's ends; 0 on a DEM."""
    if not isinstance(terrain, float):
        return [0.0, 0.0]
    away = max(abs(heights[0] - terrain), abs(heights[1] - terrain))
    return list(np.max([part.mapping.parallax_px_m for part in parts], axis=0) * away)


def misfit_facts(fit: RpcFit) -> dict[str, object]:
    """Say what the RPC misses of its model, pixels."""
    assert fit.check is not None
    return {"row": fit.check.row.as_dict(), "col": fit.check.col.as_dict()}


def removed_facts(removed: SteadyAttitude) -> dict[str, object]:
    """Give RMS, peak and strongest line of the removed rotation about each axis."""
    arcsec = removed.removed_rad / _ARCSEC_RAD
    frequency, amplitude = amplitude_spectrum(removed.times_s, arcsec)
    result: dict[str, object] = {}
    for k, axis in enumerate(_AXES):
        at = int(np.argmax(amplitude[:, k]))
        result[axis] = {
            "rms_arcsec": float(np.sqrt(np.mean(arcsec[:, k] ** 2))),
            "peak_arcsec": float(np.abs(arcsec[:, k]).max()),
            "strongest_hz": float(frequency[at]),
            "strongest_arcsec": float(amplitude[at, k]),
        }
    return result


def moved_facts(moved: FloatArray) -> dict[str, object]:
    """Give RMS about the mean and peak of what the attitude moves the rows (n, 2), pixels."""
    result: dict[str, object] = {}
    for k, name in enumerate(("row", "col")):
        known = moved[np.isfinite(moved[:, k]), k]
        away = known - known.mean() if known.size else np.full(1, np.nan)
        result[name] = {
            "rms": float(np.sqrt(np.mean(away**2))),
            "peak": float(np.abs(away).max()),
        }
    return result


def displacement_facts(
    moved: FloatArray, lines: tuple[tuple[Sinusoid, ...], tuple[Sinusoid, ...]]
) -> dict[str, object]:
    """Give statistics and strongest lines of displacements (lines, k, 2), pixels."""
    result: dict[str, object] = {}
    for k, name in enumerate(("row", "col")):
        part = moved[..., k][np.isfinite(moved[..., k])]
        away = part - part.mean()
        result[name] = {
            "mean": float(part.mean()),
            "rms": float(np.sqrt(np.mean(away**2))),
            "max": float(np.abs(part).max()),
            "lines": [line_facts(line) for line in lines[k]],
        }
    return result
