"""The adjustment repeated with fresh noise: what one survey leaves to chance, and the bound."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from geoposition.adjust import adjust
from geoposition.arrays import FloatArray
from geoposition.pushbroom import PushbroomModel
from geoposition.scripts.experiments.real.survey import (
    GPS_SIGMA_M,
    IMAGE_SIGMA_PX,
    KNOWN_SIGMA_M,
    Survey,
    bias_blocks,
    planted,
)
from geoposition.sensor_model import SensorModel

_GRID: Final = 9
_SIGMAS: Final = 1.96


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """Check points' RMS errors in space (runs) and those predicted, metres.

    `mean_px`, `std_px` (images, 2): root mean squares over the runs of the mean error of an image,
    and of the error's standard deviation over it, in (row, col).
    """

    rmse_m: FloatArray
    predicted_m: FloatArray
    mean_px: FloatArray
    std_px: FloatArray

    @property
    def ratio(self) -> tuple[float, float]:
        """Errors over prediction, root of the mean square, and half its 95 % interval."""
        squares = (self.rmse_m / self.predicted_m) ** 2
        mean = float(squares.mean())
        half = _SIGMAS * float(squares.std(ddof=1)) / np.sqrt(len(squares))
        return float(np.sqrt(mean)), half / (2.0 * float(np.sqrt(mean)))

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        ratio, half = self.ratio
        return {
            "runs": len(self.rmse_m),
            "check_rmse_m": float(np.sqrt(np.mean(self.rmse_m**2))),
            "predicted_m": float(np.sqrt(np.mean(self.predicted_m**2))),
            "ratio": ratio,
            "ratio_interval": [ratio - half, ratio + half],
            "image_mean_px": self.mean_px.tolist(),
            "image_std_px": self.std_px.tolist(),
        }


def repeat(
    models: Mapping[str, PushbroomModel],
    points: Survey,
    runs: int,
    seed: int,
    step: Callable[[], None],
) -> Repeats:
    """Plant, mark and adjust `runs` times; each run has its own random stream."""
    reference = list(models.values())
    streams = np.random.SeedSequence([seed, 1]).spawn(runs)
    rmse, predicted, means, stds = [], [], [], []
    for stream in streams:
        noise = np.random.default_rng(stream)
        spoilt = list(planted(models, noise).values())
        marks = points.marks(noise)
        gps, known = points.measured(noise), points.geodetic[points.check]
        done = adjust(
            spoilt,
            bias_blocks(spoilt),
            control=points.points(points.control, gps, GPS_SIGMA_M, marks),
            check=points.points(points.check, known, KNOWN_SIGMA_M, marks),
            ties=marks.selected(np.isin(marks.ids, points.ids[points.ties])),
            control_sigma_px=IMAGE_SIGMA_PX,
            tie_sigma_px=IMAGE_SIGMA_PX,
            robust=None,
        )
        rmse.append(done.check.rmse_m())
        predicted.append(np.sqrt(np.mean(np.sum(done.check.sigma_enu_m**2, axis=1))))
        off = [_moved(a, b) for a, b in zip(reference, done.models, strict=True)]
        means.append([np.nanmean(o, axis=0) for o in off])
        stds.append([np.nanstd(o, axis=0) for o in off])
        step()
    return Repeats(
        np.array(rmse),
        np.array(predicted),
        np.sqrt(np.mean(np.square(means), axis=0)),
        np.sqrt(np.mean(np.square(stds), axis=0)),
    )


def _grid(shape: tuple[int, int]) -> FloatArray:
    """Image points (n, 2) spread over an image."""
    lines, samples = (np.linspace(0.0, size - 1.0, _GRID) for size in shape)
    return np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1).reshape(-1, 2)


def _moved(reference: SensorModel, model: SensorModel) -> FloatArray:
    """Image points (n, 2) of `model` less those of `reference` of the same ground."""
    image = _grid(reference.shape)
    ground = reference.image_to_ground(image, float(np.mean(reference.height_range_m)))
    return model.ground_to_image(ground.geodetic).image_px - image
