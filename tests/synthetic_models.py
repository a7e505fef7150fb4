"""A sensor model whose geometry is plain: parallel lines of sight onto a plane."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from geoposition.ellipsoid import ecef_to_geodetic, enu_axes, geodetic_to_ecef
from geoposition.flags import Flag, has_result
from geoposition.rays import Rays
from geoposition.sensor_model import GroundPoints, ImagePoints

PLACE = np.array([0.1, 0.77, 0.0])


@dataclass(frozen=True)
class ParallelModel:
    """Line and sample are linear in the ground point, which is seen along one direction.

    The image's rows run south and its columns east, turned by `turn_rad`, when seen from above;
    the sight leans by `lean` = (east, north) metres per metre of height. `bend_px` adds, to the
    line, so much times the square of the height in kilometres: sight that is not straight.
    """

    lean: tuple[float, float]
    shape: tuple[int, int] = (4000, 4000)
    pixel_m: float = 0.5
    turn_rad: float = 0.0
    shift_px: tuple[float, float] = (0.0, 0.0)
    bend_px: float = 0.0
    height_range_m: tuple[float, float] = (0.0, 1000.0)
    margin_px: float = 400.0
    matrix: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        c, s = np.cos(self.turn_rad), np.sin(self.turn_rad)
        flat = np.array([[-s, -c], [c, -s]])  # d(line, sample) / d(east, north), in pixels
        matrix = np.column_stack([flat, -flat @ self.lean]) / self.pixel_m
        object.__setattr__(self, "matrix", matrix)

    @property
    def offset_px(self) -> np.ndarray:
        return 0.5 * (np.array(self.shape) - 1.0) + self.shift_px

    def ground_to_image(self, geodetic: object) -> ImagePoints:
        points = np.asarray(geodetic, dtype=float)
        local = (geodetic_to_ecef(points) - geodetic_to_ecef(PLACE)) @ enu_axes(PLACE)
        image = local @ self.matrix.T + self.offset_px
        image[..., 0] += self.bend_px * (1e-3 * points[..., 2]) ** 2
        flag = self._flag(image)
        image[~has_result(flag)] = np.nan
        return ImagePoints(image, flag)

    def image_to_ground(self, image_px: object, height_m: object) -> GroundPoints:
        image = np.asarray(image_px, dtype=float)
        height = np.asarray(height_m, dtype=float)
        shape = np.broadcast_shapes(image.shape[:-1], height.shape)
        image = np.broadcast_to(image, (*shape, 2)).copy()
        height = np.broadcast_to(height, shape)
        flag = self._flag(image)
        image[..., 0] -= self.bend_px * (1e-3 * height) ** 2
        at_up_0 = (image - self.offset_px) @ np.linalg.inv(self.matrix[:, :2]).T
        sight = np.array([*self.lean, 1.0])
        local = np.concatenate([at_up_0, np.zeros((*shape, 1))], axis=-1)
        geodetic = np.empty_like(local)
        for _ in range(4):
            ecef = geodetic_to_ecef(PLACE) + local @ enu_axes(PLACE).T
            geodetic = ecef_to_geodetic(ecef)
            local = local + (height - geodetic[..., 2])[..., None] * sight
        geodetic[~has_result(flag)] = np.nan
        return GroundPoints(geodetic, flag)

    def rays(self, image_px: object, height_m: object) -> Rays:
        ground = self.image_to_ground(image_px, height_m)
        sight = np.array([*self.lean, 1.0])
        # Along a bent sight the ground moves, per metre of height, by the line's change too.
        up = geodetic_to_ecef(ground.geodetic)
        tangent = np.broadcast_to(sight, up.shape).copy()
        move = np.stack(
            [-2e-6 * self.bend_px * ground.geodetic[..., 2], 0.0 * ground.geodetic[..., 2]], axis=-1
        )
        tangent[..., :2] += move @ np.linalg.inv(self.matrix[:, :2]).T
        direction = tangent @ enu_axes(PLACE).T
        direction /= -np.linalg.norm(direction, axis=-1, keepdims=True)
        return Rays(up - 100e3 * direction, direction, ground.flag)

    def _flag(self, image: np.ndarray) -> np.ndarray:
        flag = np.zeros(image.shape[:-1], dtype=np.uint8)
        outside = np.any((image < -0.5) | (image > np.array(self.shape) - 0.5), axis=-1)
        far = np.any(
            (image < -self.margin_px) | (image > np.array(self.shape) + self.margin_px), axis=-1
        )
        flag[outside] = Flag.OUTSIDE_IMAGE
        flag[far] = Flag.OUTSIDE_MODEL
        flag[~np.all(np.isfinite(image), axis=-1)] = Flag.BAD_INPUT
        return flag
