"""Control of the WorldView pair from a reference that is kept out of the chain.

The models as delivered are the reference: they say where points of the ground are and where the
images show them. What the chain works with are the same models with attitude turned by a known
bias and shaken by noise, and marks and positions with noise of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.adjust import best_layout
from geoposition.adjust.unknowns import ARCSEC_RAD, Block, attitude_bias
from geoposition.arrays import FloatArray, IntArray
from geoposition.attitude import Attitude
from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.errors import GeometryError
from geoposition.flags import Flag
from geoposition.observations import ControlPoints, TiePoints, diagonal_covariance
from geoposition.pushbroom import PushbroomModel

CONTROL: Final = 24
CHECK: Final = 48
TIES: Final = 200
GPS_SIGMA_M: Final = 0.05
KNOWN_SIGMA_M: Final = 0.001
"""Of the reference's own positions: exact, but a covariance must be positive."""
IMAGE_SIGMA_PX: Final = 0.2
BIAS_ARCSEC: Final = ((12.0, -8.0, 20.0), (-9.0, 15.0, -14.0))
"""Roll, pitch, yaw planted in either image: some four times what the products state."""
NOISE_ARCSEC: Final = 0.005
"""Of each attitude sample: 0.03 px, half of the motion that the vendor's RPC cannot follow."""
_DRAWN: Final = 20


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """True ground points (n, 3) and image points (images, n, 2): control, check, then ties."""

    ids: np.ndarray[tuple[int], np.dtype[np.str_]]
    geodetic: FloatArray
    image_px: FloatArray

    @property
    def control(self) -> IntArray:
        """Rows of the control points."""
        return np.arange(CONTROL)

    @property
    def check(self) -> IntArray:
        """Rows of the check points."""
        return np.arange(CONTROL, CONTROL + CHECK)

    @property
    def ties(self) -> IntArray:
        """Rows of the points of unknown ground."""
        return np.arange(CONTROL + CHECK, len(self.ids))

    def marks(self, noise: np.random.Generator) -> TiePoints:
        """Return all points as they were marked in the images."""
        images, count, _ = self.image_px.shape
        seen = self.image_px + noise.normal(0.0, IMAGE_SIGMA_PX, self.image_px.shape)
        return TiePoints(
            np.tile(self.ids, images), np.repeat(np.arange(images), count), seen.reshape(-1, 2)
        )

    def measured(self, noise: np.random.Generator) -> FloatArray:
        """Return positions (CONTROL, 3) of the control as GPS has them."""
        true = self.geodetic[self.control]
        step = noise.normal(0.0, GPS_SIGMA_M, true.shape)
        moved = geodetic_to_ecef(true) + np.einsum("nij,nj->ni", enu_axes(true), step)
        return np.asarray(ecef_to_geodetic(moved))

    def points(
        self, rows: IntArray, geodetic: FloatArray, sigma_m: float, marks: TiePoints
    ) -> ControlPoints:
        """Return some points at `geodetic`, with those of `marks` that are theirs."""
        ids = self.ids[rows]
        covariance = diagonal_covariance(sigma_m, len(rows), 3)
        return ControlPoints(ids, geodetic, covariance, marks.selected(np.isin(marks.ids, ids)))


def survey(models: Sequence[PushbroomModel], random: np.random.Generator) -> Survey:
    """Draw points over the common ground; the control is where it is most useful."""
    wanted = CONTROL + CHECK + TIES
    size = np.array(models[0].shape) - 1.0
    low = max(model.height_range_m[0] for model in models)
    high = min(model.height_range_m[1] for model in models)
    drawn = random.uniform((0.0, 0.0, low), (*size, high), (_DRAWN * wanted, 3))
    ground = models[0].image_to_ground(drawn[:, :2], drawn[:, 2]).geodetic
    seen = [model.ground_to_image(ground) for model in models]
    common = np.flatnonzero(np.all([points.flag == Flag.OK for points in seen], axis=0))
    if len(common) < wanted:
        raise GeometryError("WorldView pair: the images have too little ground in common")
    rows = common[:wanted]
    known = ground[rows[: CONTROL + CHECK]]
    chosen, _ = best_layout(models, bias_blocks(models), known, known, CONTROL,
                            sigma_enu_m=GPS_SIGMA_M, sigma_px=IMAGE_SIGMA_PX)  # fmt: skip
    others = np.setdiff1d(np.arange(CONTROL + CHECK), chosen)
    rows = rows[[*np.sort(chosen), *others, *range(CONTROL + CHECK, wanted)]]
    ids = [f"g{k + 1:02d}" for k in range(CONTROL)]
    ids += [f"c{k + 1:02d}" for k in range(CHECK)] + [f"t{k + 1:03d}" for k in range(TIES)]
    return Survey(np.array(ids), ground[rows], np.stack([p.image_px[rows] for p in seen]))


def bias_blocks(models: Sequence[PushbroomModel]) -> list[Block]:
    """Return a constant attitude bias of each image as unknown."""
    return [attitude_bias(f"image {k + 1}", models, [k]) for k in range(len(models))]


def planted(
    models: Mapping[str, PushbroomModel], noise: np.random.Generator
) -> dict[str, PushbroomModel]:
    """Return the models with the known bias and fresh noise in their attitude."""
    return {
        name: _spoilt(model, np.array(bias) * ARCSEC_RAD, noise)
        for (name, model), bias in zip(models.items(), BIAS_ARCSEC, strict=True)
    }


def _spoilt(
    model: PushbroomModel, bias_rad: FloatArray, noise: np.random.Generator
) -> PushbroomModel:
    given = model.attitude
    times = given.curve.knots_s
    turn = bias_rad + noise.normal(0.0, NOISE_ARCSEC * ARCSEC_RAD, (len(times), 3))
    body = given.rotation(times) * Rotation.from_rotvec(turn)
    spoilt = Attitude.from_samples(given.epoch, times, body.as_quat(), frame=given.frame)
    return replace(model, attitude=replace(given, curve=spoilt.curve))


def attitude_left_arcsec(reference: PushbroomModel, model: PushbroomModel) -> FloatArray:
    """Return the mean turn (3,) over the image of `model` against `reference`, body axes."""
    timing = reference.camera.timing
    lines = np.linspace(0.0, reference.shape[0] - 1.0, 201)
    times = timing.time_s(lines) + (timing.epoch - reference.attitude.epoch)
    off = reference.attitude.rotation(times).inv() * model.attitude.rotation(times)
    return np.asarray(off.as_rotvec().mean(axis=0) / ARCSEC_RAD)
