"""The camera file: look angles and mounting of a camera, for any scene it takes.

A TOML text whose tables `mounting` and `ccd` are those of our model file (`model_file`), with
CSV tables beside it where a CCD names one. A calibration writes it; a model file may name it in
place of its own two, and commands put it in the place of a product's camera. ::

    format = "geoposition camera"
    version = 1
    sensor = "for people"              # optional

    [mounting]                         # optional, as in a model file
    [[ccd]]                            # one or more, as in a model file
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from geoposition.errors import ProductError
from geoposition.pushbroom import PushbroomModel
from geoposition.sensor_model import SensorModel
from geoposition.sensors.line_camera import Ccd, LineCamera, Mounting
from geoposition.sensors.readers.model_file_camera import read_ccds, read_mounting
from geoposition.tomlfile import read_toml

CAMERA_MARK: Final = "geoposition camera"
CAMERA_VERSION: Final = 1


@dataclass(frozen=True, slots=True, eq=False)
class CameraFile:
    """A camera without a scene: its CCDs, side by side in the image row, and its mounting."""

    path: Path
    sensor: str
    ccds: tuple[Ccd, ...]
    mounting: Mounting

    def applied_to(self, model: SensorModel) -> PushbroomModel:
        """Return a scene's model with this camera's look angles and mounting.

        A `ProductError` where the model is no rigorous one, or the CCDs of its row are others.
        """
        if not isinstance(model, PushbroomModel):
            raise ProductError(self.path, "", "a scene with a rigorous model expected, not an RPC")
        mine = [ccd.samples for ccd in self.ccds]
        theirs = [round(d.last_sample - d.first_sample) + 1 for d in model.camera.detectors]
        if mine != theirs:
            raise ProductError(
                self.path, "ccd", f"CCDs of {theirs} samples expected as in the scene, got {mine}"
            )
        camera = LineCamera(model.shape[0], model.camera.timing, self.ccds, self.mounting)
        return PushbroomModel(
            camera, model.ephemeris, model.attitude, model.corrections, model.height_range_m
        )


def read_camera_file(path: str | Path) -> CameraFile:
    """Read the camera file `path`.

    Raises `ProductError` with the file and the key, or the table and the line, at fault.
    """
    root = read_toml(Path(path))
    if root.text("format", "") != CAMERA_MARK:
        root.refuse("format", f'"{CAMERA_MARK}" expected')
    if root.need("version") != CAMERA_VERSION:
        root.refuse("version", f"{CAMERA_VERSION} expected, newer files need a newer toolkit")
    sensor, ccds, mounting = root.text("sensor", ""), read_ccds(root), read_mounting(root)
    root.finish()
    return CameraFile(root.path, sensor, ccds, mounting)
