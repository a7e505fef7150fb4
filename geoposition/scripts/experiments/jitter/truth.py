"""Steady images against the truth, and what the telemetry allows at best.

A steady pixel shows ground that its source pixel saw, with the true attitude; the error is the
pixel less where the steady model puts that ground: observed less modelled, as in a match. What
one scene has in common is its absolute error, the rest its relative one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.locate import locate
from geoposition.pushbroom import PushbroomModel
from geoposition.reimage.mapping import SourceMapping, map_models
from geoposition.reimage.steady import steady_model
from geoposition.scripts.experiments.jitter.cases import IFOV_RAD
from geoposition.sensor_model import SensorModel
from geoposition.terrain import Terrain

_ROW_STEP: Final = 11
"""Rows between those that are compared: no multiple of it fits the jitter's periods."""
_COLUMNS: Final = 3
GOAL_PX: Final = 0.10
"""What a steady image's relative error shall not exceed."""
_FINE: Final = 201
_TERMS: Final = 20
_DRAWS: Final = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class TrueError:
    """Errors (n, k, 2) of a steady image at `rows` (n,) and `cols` (k,), in pixels."""

    rows: FloatArray
    cols: FloatArray
    error_px: FloatArray

    @property
    def mean_px(self) -> FloatArray:
        """Mean (line, sample): the scene's shift."""
        return np.asarray(np.nanmean(self.error_px, axis=(0, 1)))

    @property
    def rms_px(self) -> FloatArray:
        """Root mean square about the mean, along and across."""
        return np.asarray(np.sqrt(np.nanmean((self.error_px - self.mean_px) ** 2, axis=(0, 1))))

    @property
    def relative_px(self) -> float:
        """Two-dimensional root mean square about the mean."""
        return float(np.hypot(*self.rms_px))

    @property
    def profile_px(self) -> FloatArray:
        """Mean over the columns about the scene's mean, (n, 2)."""
        return np.asarray(np.nanmean(self.error_px, axis=1) - self.mean_px)


def steady_error(
    true: PushbroomModel, steady: SensorModel, believed: PushbroomModel, terrain: Terrain
) -> TrueError:
    """Compare a `steady` image, made with a `believed` attitude, with the `true` model."""
    mapping = map_models(steady, believed, terrain)
    lines, samples = steady.shape
    rows = np.arange(0.0, lines, _ROW_STEP)
    cols = np.linspace(0.0, samples - 1.0, _COLUMNS)
    image = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1)
    source = _as_imaged(mapping, image)
    ground = locate(true, source, terrain).geodetic
    shown = steady.ground_to_image(ground).image_px
    return TrueError(rows, cols, np.asarray(image - shown))


def mapping_error(true: PushbroomModel, terrain: Terrain) -> TrueError:
    """Make a steady image with the true attitude and compare: what the mapping alone costs."""
    steady, _ = steady_model(true)
    return steady_error(true, steady, true, terrain)


def _as_imaged(mapping: SourceMapping, image: FloatArray) -> FloatArray:
    """Places (n, k, 2) in the source of the target's pixels, interpolated as an image is."""
    out = np.empty_like(image)
    lines, block = mapping.target.shape[0], 4096
    for start in range(0, lines, block):
        stop = min(start + block, lines)
        moved = mapping.rows(start, stop).displacement_px(image[0, :, 1])
        here = (image[:, 0, 0] >= start) & (image[:, 0, 0] < stop)
        row = image[here, 0, 0].astype(np.int64) - start
        out[here] = image[here] + moved[row]
    return out


@dataclass(frozen=True, slots=True)
class Telemetry:
    """What decides how well attitude can be known: noise, rates, spans."""

    star_sigma_rad: float
    star_hz: float
    heads: int
    angle_random_walk: float
    span_s: float
    image_s: float


@dataclass(frozen=True, slots=True)
class Bound:
    """What no estimate beats, pixels: two-dimensional relative error, absolute sigma per axis.

    `relative_px` is the root of the expected square; one scene's own figure scatters about it,
    and 95 of 100 are below `relative_95_px`. `share_above` is the share above 0.10 px.
    """

    relative_px: float
    relative_95_px: float
    share_above: float
    absolute_px: float


def attainable(told: Telemetry) -> Bound:
    """Say how well the attitude of an image can be known from its telemetry.

    The posterior covariance of one angle whose increments are measured with a random walk and an
    unknown constant drift, and which star samples fix: about the image's mean for the relative
    error, of that mean for the absolute one. Exact for the linear model (Cramér–Rao), and
    independent of any filter. Roll and pitch count alike.
    """
    knots, covariance = _posterior(told)
    inside = np.flatnonzero(np.abs(knots) <= 0.5 * told.image_s + 1e-9)
    share = np.gradient(knots[inside])
    share /= share.sum()
    part = covariance[np.ix_(inside, inside)]
    mean = float(share @ part @ share)
    away = np.eye(len(inside)) - share
    root = np.sqrt(share)
    scatter = root[:, None] * (away @ part @ away.T) * root
    strongest = np.linalg.eigvalsh(scatter)[::-1][:_TERMS] / IFOV_RAD**2
    rng = np.random.default_rng(0)
    draws = np.sqrt(rng.chisquare(2.0, (_DRAWS, _TERMS)) @ strongest)
    return Bound(
        float(np.sqrt(2.0 * np.trace(scatter))) / IFOV_RAD,
        float(np.quantile(draws, 0.95)),
        float(np.mean(draws > GOAL_PX)),
        float(np.sqrt(mean)) / IFOV_RAD,
    )


def _posterior(told: Telemetry) -> tuple[FloatArray, FloatArray]:
    """Return times, and the covariance of the angle there: the inverse of its information."""
    half = np.floor(0.5 * told.span_s * told.star_hz)
    star = np.round(np.arange(-half, half + 1.0) / told.star_hz, 9)
    fine = np.linspace(-0.5 * told.image_s, 0.5 * told.image_s, _FINE).round(9)
    knots = np.union1d(star, fine)
    n = len(knots)
    step = np.diff(knots)
    weight = 1.0 / (told.angle_random_walk**2 * step)
    # a measured increment is the angle's, plus drift (the last unknown) times the step
    turn = np.zeros((n - 1, n + 1))
    k = np.arange(n - 1)
    turn[k, k], turn[k, k + 1], turn[:, n] = -1.0, 1.0, step
    information = turn.T @ (weight[:, None] * turn)
    seen = np.searchsorted(knots, star)
    information[seen, seen] += told.heads / told.star_sigma_rad**2
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * scale[:, None] * scale) * scale[:, None] * scale
    return knots, np.asarray(covariance[:n, :n])
