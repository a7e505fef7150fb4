"""Rigorous models with a known error: turned, moved, late; for tests."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import ProductCurve, RotationCurve
from geoposition.interpolation import Curve
from geoposition.pushbroom import PushbroomModel


@dataclass(frozen=True)
class Turned:
    """One rotation at all times of `like`."""

    like: RotationCurve
    rotvec: FloatArray

    @property
    def span_s(self) -> tuple[float, float]:
        return self.like.span_s

    @property
    def knots_s(self) -> FloatArray:
        return self.like.knots_s

    def rotation(self, times_s: FloatArray) -> Rotation:
        return Rotation.from_rotvec(np.tile(self.rotvec, (len(times_s), 1)))


@dataclass(frozen=True)
class Moved:
    """A curve with a constant added."""

    curve: Curve
    by: FloatArray

    @property
    def span_s(self) -> tuple[float, float]:
        return self.curve.span_s

    @property
    def knots_s(self) -> FloatArray:
        return self.curve.knots_s

    def value(self, times_s: FloatArray) -> FloatArray:
        return self.curve.value(times_s) + self.by

    def rate(self, times_s: FloatArray) -> FloatArray:
        return self.curve.rate(times_s)


def turned_in_body(model: PushbroomModel, rotvec_rad: FloatArray) -> PushbroomModel:
    """R exp(d)."""
    attitude = model.attitude
    curve = ProductCurve(attitude.curve, Turned(attitude.curve, rotvec_rad))
    return replace(model, attitude=replace(attitude, curve=curve))


def turned_in_ecef(model: PushbroomModel, rotvec_rad: FloatArray) -> PushbroomModel:
    """exp(d) R."""
    attitude = model.attitude
    curve = ProductCurve(Turned(attitude.curve, rotvec_rad), attitude.curve)
    return replace(model, attitude=replace(attitude, curve=curve))


def moved_in_ecef(model: PushbroomModel, by_m: FloatArray) -> PushbroomModel:
    ephemeris = model.ephemeris
    return replace(model, ephemeris=replace(ephemeris, curve=Moved(ephemeris.curve, by_m)))


@dataclass(frozen=True)
class Late:
    """Line times with a constant added."""

    timing: object
    by_s: float

    def __getattr__(self, name: str) -> object:
        return getattr(self.timing, name)

    def time_s(self, line: FloatArray) -> FloatArray:
        return self.timing.time_s(line) + self.by_s  # type: ignore[attr-defined]

    def line_at(self, time_s: FloatArray) -> FloatArray:
        return self.timing.line_at(np.asarray(time_s) - self.by_s)  # type: ignore[attr-defined]


def late(model: PushbroomModel, by_s: float) -> PushbroomModel:
    camera = model.camera
    return replace(model, camera=replace(camera, timing=Late(camera.timing, by_s)))  # type: ignore[type-var]
