"""From fitted ratios to an `RpcModel` with its normalisation, and what is known of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geoposition.arrays import FloatArray, read_only
from geoposition.errors import ArgumentError, GeometryError
from geoposition.rpc.direct import DirectRpc
from geoposition.rpc.fit_check import FitCheck
from geoposition.rpc.fit_grid import Normalisation
from geoposition.rpc.fit_ratio import Fitted, fit_direct
from geoposition.rpc.fit_region import FittedRegion
from geoposition.rpc.fit_solve import FitOptions
from geoposition.rpc.model import RpcModel


@dataclass(frozen=True, slots=True, eq=False)
class RpcFit:
    """An RPC with what is known of it.

    `rms_px` (line, sample) is at the points of the fit. `covariance` (2, 39, 39) is of the
    twenty numerator and nineteen denominator coefficients (the first is 1) of line and sample,
    taking the misfit at each point as an error of its own; `effective` (2) is how many of them
    the points determine, `strength` (2) the damping chosen from the data (squares of pixels).
    """

    model: RpcModel
    region: FittedRegion
    points: int
    rms_px: tuple[float, float]
    covariance: FloatArray
    effective: FloatArray
    strength: FloatArray
    check: FitCheck | None
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        """Return the summary by name."""
        result: dict[str, object] = {
            "points": self.points,
            "rms_px": list(self.rms_px),
            "region": self.region.statement(),
            "effective_parameters": self.effective.tolist(),
            "damping": self.strength.tolist(),
            "warnings": list(self.warnings),
        }
        if self.check is not None:
            result["check"] = self.check.as_dict()
        return result


def build_direct(
    normal: Normalisation, image: FloatArray, ground: FloatArray, options: FitOptions
) -> DirectRpc:
    """Fit image to ground: normalised (line, sample) (2, n) to (lon, lat, height) (3, n)."""
    metres = normal.metres
    pixel_m = float(np.hypot(*metres) / np.hypot(*normal.image_scale_px))
    fitted = fit_direct(
        np.stack([image[1], image[0], ground[2]]),
        ground[:2],
        metres,
        replace(options, floor=options.floor * pixel_m, least_strength=0.0),
    )
    rms = np.sqrt((fitted.ratios.residual**2).mean(axis=1)) * metres
    return DirectRpc(
        lon_num=fitted.num[0],
        lon_den=fitted.den[0],
        lat_num=fitted.num[1],
        lat_den=fitted.den[1],
        fit_error_m=(float(rms[0]), float(rms[1])),
    )


def build_fit(
    normal: Normalisation,
    inverse: Fitted,
    direct: DirectRpc | None,
    region: FittedRegion,
    shape: tuple[int, int] | None,
    warnings: tuple[str, ...],
) -> RpcFit:
    """Put the RPC and the facts of its fit together; a `GeometryError` if it has no inverse."""
    ratios = inverse.ratios
    rms = np.sqrt((ratios.residual**2).mean(axis=1)) * normal.image_scale_px
    rms_px = float(rms[0]), float(rms[1])
    try:
        model = RpcModel(
            line_off_px=float(normal.image_off_px[0]),
            line_scale_px=float(normal.image_scale_px[0]),
            samp_off_px=float(normal.image_off_px[1]),
            samp_scale_px=float(normal.image_scale_px[1]),
            lon_off_deg=normal.lon_off_deg,
            lon_scale_deg=float(normal.ground_scale[0]),
            lat_off_deg=float(normal.ground_off[1]),
            lat_scale_deg=float(normal.ground_scale[1]),
            height_off_m=float(normal.ground_off[2]),
            height_scale_m=float(normal.ground_scale[2]),
            line_num=inverse.num[0],
            line_den=inverse.den[0],
            samp_num=inverse.num[1],
            samp_den=inverse.den[1],
            image_shape=shape,
            fit_error_px=rms_px,
            direct=direct,
            validity=region.validity,
        )
    except ArgumentError as error:
        raise GeometryError(f"RPC fit: the points determine no usable RPC ({error})") from None
    return RpcFit(
        model=model,
        region=region,
        points=ratios.residual.shape[1],
        rms_px=rms_px,
        covariance=read_only(inverse.covariance),
        effective=read_only(ratios.effective),
        strength=read_only(ratios.strength),
        check=None,
        warnings=warnings,
    )
