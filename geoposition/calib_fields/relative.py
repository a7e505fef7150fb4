"""What is taken out before the internal accuracy: a shift, an affine map, a constant attitude."""

from __future__ import annotations

from typing import Final, Literal, TypeAlias

import numpy as np

from geoposition.arrays import BoolArray, FloatArray
from geoposition.errors import ArgumentError
from geoposition.flags import has_result
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel

Relative: TypeAlias = Literal["shift", "affine", "attitude"]

RELATIVES: Final = ("shift", "affine", "attitude")
_TURN_RAD: Final = 1e-5


def relative_terms(
    kind: Relative, model: SensorModel, ground: FloatArray, image_px: FloatArray
) -> FloatArray:
    """Columns (n, 2, k) that a fit takes out of the errors (n, 2) in line and sample.

    `attitude` is a constant turn about three axes: by the rigorous model's own mounting, else,
    for an RPC, what such a turn does to a push-broom image seen straight down: two shifts, and
    lines that move in proportion to the sample.
    """
    n = len(image_px)
    if kind not in RELATIVES:
        raise ArgumentError(f"relative: one of {', '.join(RELATIVES)} expected, got {kind!r}")
    if kind == "attitude" and isinstance(model, PushbroomModel):
        return _turned(model, ground)
    place = (image_px - image_px.mean(axis=0)) / np.maximum(np.ptp(image_px, axis=0), 1.0)
    one, zero = np.ones(n), np.zeros(n)
    line, sample = place[:, 0], place[:, 1]
    columns = [(one, zero), (zero, one)]
    if kind == "affine":
        columns += [(line, zero), (sample, zero), (zero, line), (zero, sample)]
    elif kind == "attitude":
        columns += [(sample, zero)]
    return np.stack([np.stack(column, axis=-1) for column in columns], axis=-1)


def _turned(model: PushbroomModel, ground: FloatArray) -> FloatArray:
    at = model.ground_to_image(ground)
    columns = []
    for axis in "xyz":
        camera = model.camera.with_parameters({f"mounting_{axis}_rad": _TURN_RAD})
        turned = PushbroomModel(
            camera, model.ephemeris, model.attitude, model.corrections, model.height_range_m
        ).ground_to_image(ground)
        moved = np.where(
            (has_result(at.flag) & has_result(turned.flag))[:, None],
            turned.image_px - at.image_px,
            0.0,
        )
        columns.append(moved / max(float(np.max(np.abs(moved))), 1e-12))
    return np.stack(columns, axis=-1)


def fitted(terms: FloatArray, error_px: FloatArray, used: BoolArray) -> FloatArray:
    """Fit (n, 2) of `terms` to `error_px` of the points `used`, at all points."""
    rows = terms[used].reshape(-1, terms.shape[-1])
    solution = np.linalg.lstsq(rows, error_px[used].reshape(-1), rcond=1e-10)[0]
    result: FloatArray = terms @ solution
    return result
