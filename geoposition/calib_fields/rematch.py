"""The same measurements judged by another model of the same image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geoposition.calib_fields.match_block import on_ground
from geoposition.calib_fields.matches import DomMatches
from geoposition.flags import has_result
from geoposition.sensor_model import SensorModel


def rematched(matches: DomMatches, model: SensorModel) -> DomMatches:
    """Return `matches` with model places and shifts on the ground by `model`.

    What was measured, ground points and image points, stays; `model` is one of the same image.
    """
    projected = model.ground_to_image(matches.ground)
    seen = has_result(projected.flag)[:, None]
    model_px = np.where(seen, projected.image_px, np.nan)
    measured = np.isfinite(matches.image_px).all(axis=1) & seen[:, 0]
    shift, covariance = np.full((len(seen), 2), np.nan), np.full((len(seen), 2, 2), np.nan)
    shift[measured], covariance[measured] = on_ground(
        model,
        matches.ground[measured],
        matches.image_px[measured],
        matches.covariance_px2[measured],
        model_px[measured],
    )
    return replace(matches, model_px=model_px, shift_en_m=shift, covariance_m2=covariance)
