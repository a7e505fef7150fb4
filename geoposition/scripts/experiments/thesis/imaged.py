"""The whole chain once, through images and files that the other commands read.

Orbit and camera are ZY-3's, of which one of four CCDs of each oblique camera is rendered. What
each step makes lies in one folder, so that a user can enter or leave the chain anywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from geoposition.scripts.experiments.thesis.attitude_chain import AttitudeChain, run_attitude
from geoposition.scripts.experiments.thesis.control import Layout, measured_points
from geoposition.scripts.experiments.thesis.field import make_field
from geoposition.scripts.experiments.thesis.fusion import Kind, fused_attitude, raw_attitude
from geoposition.scripts.experiments.thesis.scene import Scene, zy3_scene
from geoposition.scripts.experiments.thesis.stereo_chain import StereoChain, run_stereo
from geoposition.scripts.experiments.thesis.telemetry import Instruments, draw
from geoposition.scripts.experiments.thesis.telemetry_files import Spoilt, write_telemetry
from geoposition.sensors.simulate import zy3_cameras

STEPS: Final = 20


@dataclass(frozen=True, slots=True)
class Size:
    """Lines and samples of the rendered images."""

    lines: int
    samples: int


FULL: Final = Size(3000, 3072)
QUICK: Final = Size(800, 800)


@dataclass(frozen=True, slots=True, eq=False)
class Imaged:
    """All that the chain made and found."""

    size: Size
    scene: Scene
    plan: Layout
    spoilt: Spoilt
    attitude: AttitudeChain
    stereo: StereoChain

    def as_json(self) -> dict[str, Any]:
        """Figures by name."""
        return {
            "lines": self.size.lines,
            "samples": self.size.samples,
            "planted": asdict(self.spoilt),
            **self.attitude.as_json(),
            **self.stereo.as_json(),
        }


def run_imaged(folder: Path, size: Size, seed: int, progress: Callable[[int, int], None]) -> Imaged:
    """Fly, measure, fuse, render, match, compensate, intersect; everything into `folder`."""
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        progress(done, STEPS)

    scene = imaged_scene(size, seed)
    flight, survey, damage = np.random.SeedSequence([seed, 3]).spawn(3)
    flown = Instruments()
    telemetry = draw(scene, flown, flight)
    spoilt = write_telemetry(folder, telemetry, flown, np.random.default_rng(damage))
    step()
    field = make_field(scene, folder, seed)
    step()
    attitude = run_attitude(scene, folder, flown, step)
    known = replace(telemetry, star=attitude.fused.telemetry.star)
    attitudes: dict[Kind, Any] = {
        "raw": raw_attitude(scene, known, flown),
        "fused": fused_attitude(scene, attitude.fused.estimate),
        "true": next(iter(scene.models.values())).attitude,
    }
    marks = measured_points(scene, field.plan, survey)
    stereo = run_stereo(scene, field, telemetry, attitudes, marks, seed, step)
    return Imaged(size, scene, field.plan, spoilt, attitude, stereo)


def imaged_scene(size: Size, seed: int) -> Scene:
    """One CCD of the forward and the backward camera over Songshan."""
    forward, _, backward = zy3_cameras()
    straight: dict[str, Any] = {
        "ccds": 1,
        "ccd_samples": size.samples,
        "lines": size.lines,
        "ccd_offset_px": (0.0,),
        "ccd_rotation_rad": (0.0,),
    }
    return zy3_scene((replace(forward, **straight), replace(backward, **straight)), seed)
