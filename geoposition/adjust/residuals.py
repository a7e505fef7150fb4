"""Residuals of one image's observations, and their derivatives by its unknowns.

For an observation p of a ground point X, with the line of sight of p moved by the corrections to
S' + range u', the residual is J (S' + range u' − X) − b: J pixels per metre, zero along u', b the
image bias. That is p less the projection of X, in first order of what is left between them,
and the closer the closer the iteration comes to its end. The line of sight belongs to the
measured pixel, so it never has to be made anew while the unknowns change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.adjust.residual_kernels import observe
from geoposition.adjust.sights import Frames, Sights, line_times_s
from geoposition.adjust.unknowns import Block
from geoposition.arrays import FloatArray, IntArray
from geoposition.camera import Camera
from geoposition.errors import ArgumentError
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel

_RATE_STEP_LINES = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class ImageEquations:
    """The image's model and blocks of unknowns; `columns` (p,) are their places among all.

    `start[i]` .. `start[i + 1]` of `columns` belong to `blocks[i]`.
    """

    model: SensorModel
    frames: Frames
    blocks: tuple[Block, ...]
    start: IntArray
    columns: IntArray

    @classmethod
    def of(
        cls, image: int, model: SensorModel, blocks: Sequence[Block], first: IntArray
    ) -> ImageEquations:
        """Equations of `image`; block i of all `blocks` has its unknowns from `first[i]` on."""
        mine = [i for i, block in enumerate(blocks) if image in block.images]
        for i in mine:
            if blocks[i].kind != "image" and not isinstance(model, PushbroomModel):
                raise ArgumentError(
                    f"{blocks[i].name}: image {image} has no rigorous model; use image_bias"
                )
        sizes = [len(blocks[i]) for i in mine]
        parts = [np.arange(first[i], first[i] + len(blocks[i])) for i in mine]
        columns = np.concatenate(parts) if parts else np.empty(0)
        return cls(
            model,
            Frames.of(model),
            tuple(blocks[i] for i in mine),
            np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
            columns.astype(np.int64),
        )

    def evaluate(
        self, sights: Sights, ground_ecef_m: FloatArray, theta: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals (n, 2) and their derivatives, for all unknowns `theta`.

        By the line of sight's place (n, 2, 3), in metres, and by the image's unknowns (n, 2, p).
        """
        n = len(sights.image_px)
        corrections = _Corrections.of(self, sights, theta)
        residual, by_ground = np.empty((n, 2)), np.empty((n, 2, 3))
        by_turn, by_mounting = np.empty((n, 2, 3)), np.empty((n, 2, 3))
        by_tangent = np.empty((n, 2, 2))
        observe(
            sights.image_px,
            sights.origin_ecef_m,
            sights.direction_ecef,
            sights.scale,
            np.ascontiguousarray(ground_ecef_m),
            self.frames.first_line,
            1.0 / self.frames.step_lines,
            self.frames.R_ecef_body,
            self.frames.R_body_camera,
            corrections.turns,
            corrections.mounting,
            corrections.tangents,
            corrections.moved_m,
            residual,
            by_ground,
            by_turn,
            by_mounting,
            by_tangent,
        )
        residual += corrections.line_shift_px
        residual -= corrections.bias_px
        jacobian = np.empty((n, 2, len(self.columns)))
        for i, block in enumerate(self.blocks):
            part = jacobian[:, :, self.start[i] : self.start[i + 1]]
            if block.kind == "attitude":
                _spread(part, corrections.functions[i], by_turn)
            elif block.kind == "mounting":
                part[:] = by_mounting
            elif block.kind == "orbit":
                _spread(part, corrections.functions[i], by_ground @ block.axes_ecef)
            elif block.kind == "time":
                part[:, 0, 0] = corrections.lines_per_s
                part[:, 1, 0] = 0.0
            elif block.kind == "look":
                _spread(part, corrections.functions[i], by_tangent)
            else:
                functions = corrections.functions[i]
                part[:] = 0.0
                part[:, 0, 0::2] = -functions
                part[:, 1, 1::2] = -functions
        return residual, by_ground, jacobian


def _spread(out: FloatArray, functions: FloatArray, by_axis: FloatArray) -> None:
    """Fill `out` (n, 2, m k) with `functions` (n, m) times `by_axis` (n, 2, k)."""
    k = by_axis.shape[2]
    for j in range(functions.shape[1]):
        np.multiply(by_axis, functions[:, j, None, None], out=out[:, :, j * k : (j + 1) * k])


def plane_functions(image_px: FloatArray, shape: tuple[int, int], degree: int) -> FloatArray:
    """Constants, or 1, line, sample from −1 to 1 over an image of `shape`: (n, 1 or 3)."""
    one = np.ones((len(image_px), 1))
    if degree == 0:
        return one
    middle = 0.5 * (np.array(shape) - 1.0)
    return np.concatenate([one, (image_px - middle) / np.maximum(middle, 0.5)], axis=1)


def image_plane(values: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Rows line and sample (2, 3) as constant, per line, per sample, of an image block."""
    plane = np.zeros((2, 3))
    table = values.reshape(-1, 2)
    plane[:, 0] = table[0]
    if len(table) == 3:
        middle = 0.5 * (np.array(shape) - 1.0)
        plane[:, 1:] = table[1:].T / np.maximum(middle, 0.5)
        plane[:, 0] -= plane[:, 1:] @ middle
    return plane


def look_functions(block: Block, camera: Camera, samples: FloatArray) -> FloatArray:
    """Powers (n, degree + 1) of a look block's own s; zero on other CCDs than its own."""
    powers = sample_powers(samples, look_ends(block, camera), block.degree)
    if block.detector is None:
        return powers
    firsts = [detector.first_sample - 0.5 for detector in camera.detectors[1:]]
    number = np.searchsorted(firsts, samples, side="right")
    powers[number != block.detector] = 0.0
    return powers


def look_ends(block: Block, camera: Camera) -> tuple[float, float]:
    """Return the samples at which s of a look block is −1 and 1."""
    if block.detector is None:
        return 0.0, camera.shape[1] - 1.0
    if not 0 <= block.detector < len(camera.detectors):
        raise ArgumentError(
            f"{block.name}: the camera has {len(camera.detectors)} CCDs, none numbered "
            f"{block.detector}"
        )
    own = camera.detectors[block.detector]
    return own.first_sample, own.last_sample


def sample_powers(samples: FloatArray, ends: tuple[float, float], degree: int) -> FloatArray:
    """Powers (n, degree + 1) of s, the sample from −1 to 1 between `ends`."""
    middle, half = 0.5 * (ends[0] + ends[1]), max(0.5 * (ends[1] - ends[0]), 0.5)
    return np.vander((samples - middle) / half, degree + 1, increasing=True)


@dataclass(slots=True)
class _Corrections:
    """Present corrections of each observation, and the functions that make them."""

    turns: FloatArray
    mounting: FloatArray
    tangents: FloatArray
    moved_m: FloatArray
    line_shift_px: FloatArray
    bias_px: FloatArray
    lines_per_s: FloatArray
    functions: list[FloatArray]

    @classmethod
    def of(cls, image: ImageEquations, sights: Sights, theta: FloatArray) -> _Corrections:
        n, model, px = len(sights.image_px), image.model, sights.image_px
        out = cls(
            np.zeros((n, sum(block.kind == "attitude" for block in image.blocks), 3)),
            np.eye(3),
            np.zeros((n, 2)),
            np.zeros((n, 3)),
            np.zeros((n, 2)),
            np.zeros((n, 2)),
            np.zeros(n),
            [],
        )
        offset_s = sum(
            float(theta[image.columns[image.start[i]]])
            for i, block in enumerate(image.blocks)
            if block.kind == "time"
        )
        seen = 0
        turn = Rotation.identity()
        for i, block in enumerate(image.blocks):
            values = theta[image.columns[image.start[i] : image.start[i + 1]]]
            functions = np.empty((n, 0))
            if block.kind in ("attitude", "orbit"):
                assert block.basis is not None
                times = line_times_s(model, px[:, 0], block.basis.epoch) + offset_s
                functions = block.basis.values(times)
                change = functions @ values.reshape(-1, 3)
                if block.kind == "attitude":
                    out.turns[:, seen] = change
                    seen += 1
                else:
                    out.moved_m += change @ block.axes_ecef.T
            elif block.kind == "mounting":
                turn = turn * Rotation.from_rotvec(values)
            elif block.kind == "time":
                out.lines_per_s = _lines_per_s(model, px[:, 0])
                out.line_shift_px[:, 0] = offset_s * out.lines_per_s
            elif block.kind == "look":
                assert isinstance(model, PushbroomModel)
                functions = look_functions(block, model.camera, px[:, 1])
                out.tangents += functions @ values.reshape(-1, 2)
            else:
                plane = image_plane(values, model.shape)
                # observed = model + b + B model, so the model's own point is the undone one
                inverse = np.linalg.inv(np.eye(2) + plane[:, 1:])
                own = (px - plane[:, 0]) @ inverse.T
                out.bias_px += px - own
                functions = plane_functions(own, model.shape, block.degree)
            out.functions.append(functions)
        out.mounting = np.ascontiguousarray(turn.as_matrix())
        return out


def _lines_per_s(model: SensorModel, lines: FloatArray) -> FloatArray:
    assert isinstance(model, PushbroomModel)
    timing = model.camera.timing
    step = timing.time_s(lines + _RATE_STEP_LINES) - timing.time_s(lines - _RATE_STEP_LINES)
    result: FloatArray = 2.0 * _RATE_STEP_LINES / step
    return result
