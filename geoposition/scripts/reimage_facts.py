"""What a re-imaging run says of itself, as plain numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.reimage.sinusoids import Sinusoid, amplitude_spectrum, strongest
from geoposition.reimage.steady import SteadyAttitude
from geoposition.reimage.strips import Part
from geoposition.rpc.fit_build import RpcFit
from geoposition.terrain import Terrain

_MOST_LINES: Final = 6
_LEAST_ROWS: Final = 64
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


def strongest_lines(times: FloatArray, values: FloatArray) -> tuple[Sinusoid, ...]:
    """Find the strongest lines of a displacement; none where the image is too short."""
    if min(len(times), np.isfinite(values).sum()) < _LEAST_ROWS:
        return ()
    order = slice(None, None, 1 if times[-1] > times[0] else -1)
    return strongest(times[order], values[order], _MOST_LINES)


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
            "lines": [
                {
                    "frequency_hz": line.frequency_hz,
                    "amplitude_px": line.amplitude,
                    "phase_rad": line.phase_rad,
                    "sigma_frequency_hz": line.sigma_frequency_hz,
                    "sigma_amplitude_px": line.sigma_amplitude,
                    "sigma_phase_rad": line.sigma_phase_rad,
                }
                for line in lines[k]
            ],
        }
    return result
