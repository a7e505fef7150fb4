"""What a re-imaging run starts from: product, image, and the attitude to believe."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from geoposition.attitude import Attitude
from geoposition.errors import ArgumentError, ProductError, SpanError
from geoposition.frames import R_itrs_gcrs
from geoposition.product import Product
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.raster_files import ImageFile
from geoposition.reimage.virtual import cropped_model
from geoposition.scripts.product_images import check_size
from geoposition.sensors.readers.attitude_columns import column_map
from geoposition.sensors.readers.attitude_tables import read_star
from geoposition.timescale import Epoch

_PAD_S: Final = 2.0
_PAD_PERIODS: Final = 5.0


@dataclass(frozen=True, slots=True)
class AttitudeInput:
    """An attitude table, how to read it, and the epoch of its t = 0 where it is known."""

    path: Path
    columns: Path | None = None
    frame: str = "inertial"
    epoch_utc: str | None = None


def jittered_model(
    product: Product, image: ImageFile, attitude: AttitudeInput | None, cutoff_hz: float | None
) -> PushbroomModel:
    """Model of the image as it was taken, with the attitude that is believed."""
    model = product.model
    if not isinstance(model, PushbroomModel):
        raise ProductError(
            product.path, "", "a rigorous model expected; an RPC does not hold what jitter was"
        )
    if attitude is not None:
        model = _with_attitude(model, attitude, cutoff_hz)
    check_size(model, image)
    return cropped_model(model, image.first_line, image.first_sample, image.shape)


def _with_attitude(
    model: PushbroomModel, source: AttitudeInput, cutoff_hz: float | None
) -> PushbroomModel:
    """Replace the attitude of `model` by the table's, around the image's own time."""
    epoch = None if source.epoch_utc is None else Epoch.from_utc(source.epoch_utc)
    table = read_star(source.path, column_map(source.columns, None), epoch)
    series = table.series
    if len(series.heads) > 1:
        raise ProductError(
            source.path, "column sensor", "one fused attitude expected, there are several heads"
        )
    start = table.epoch or epoch or model.attitude.epoch
    timing = model.camera.timing
    ends = timing.time_s(np.array([0.0, model.shape[0] - 1.0])) + (timing.epoch - start)
    low, high = float(np.min(ends)), float(np.max(ends))
    times = np.asarray(series.times_s)
    if not (times[0] <= low and high <= times[-1]):
        raise ProductError(
            source.path, "column t_s",
            f"times over the image's {low:.4f} .. {high:.4f} s expected, there are "
            f"{times[0]:.4f} .. {times[-1]:.4f} s (counted from --epoch, or the product's own "
            "attitude epoch)",
        )  # fmt: skip
    pad = _PAD_S if cutoff_hz is None else max(_PAD_S, _PAD_PERIODS / cutoff_hz)
    keep = (times >= low - pad) & (times <= high + pad)
    if keep.sum() < 4:
        raise ProductError(source.path, "column t_s", "at least 4 samples around the image needed")
    times = times[keep]
    rotation = series.R_inertial_sensor[np.flatnonzero(keep)]
    if source.frame == "inertial":
        rotation = R_itrs_gcrs(start, times) * rotation
    elif source.frame != "itrs":
        raise ArgumentError(f"--attitude-frame: inertial or itrs expected, got {source.frame!r}")
    believed = Attitude.from_samples(start, times, rotation.as_quat(), "itrs", "spline")
    try:
        return replace(model, attitude=believed)
    except SpanError as error:
        raise ProductError(source.path, "", str(error)) from None
