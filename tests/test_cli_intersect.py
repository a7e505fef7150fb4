"""`geoposition intersect` with a table of ties: names of products, checks, outputs, refusals."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pyogrio
import pytest

import scenes
from geoposition.scripts.cli import run
from geoposition.sensors.writers.model_file import write_model_file

SHAPE = (2000, 1500)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with two models that look at one place, and ties and control of known points."""
    folder = tmp_path_factory.mktemp("stereo")
    models = [scenes.build(SHAPE, pitch_deg=p, middle_s=m).model() for p, m in ((0, 0), (0, 0))]
    del models[1]
    first = models[0]
    # The second looks back at the same ground from further along the orbit.
    centre = first.image_to_ground(np.array([999.5, 749.5]), 500.0).geodetic
    second = looking_back_at(centre)
    write_model_file(first, folder / "nadir.toml")
    write_model_file(second, folder / "back.toml")
    rng = np.random.default_rng(5)
    ground = centre + rng.uniform(-1, 1, (40, 3)) * [3e-5, 3e-5, 300.0]
    with (folder / "ties.csv").open("w") as ties, (folder / "gcps.csv").open("w") as gcps:
        ties.write("id,product,row,col\n")
        gcps.write("id,lon,lat,height\n")
        for i, point in enumerate(ground):
            lon, lat = np.degrees(point[:2])
            gcps.write(f"p{i},{lon:.15g},{lat:.15g},{point[2]:.9g}\n")
            for name, model in (("nadir.toml", first), ("back", second)):
                image = model.ground_to_image(point)
                assert image.flag == 0
                line, sample = image.image_px
                ties.write(f"p{i},{name},{line:.12g},{sample:.12g}\n")
    return folder


def looking_back_at(centre: np.ndarray) -> object:
    """Model from 25 s later whose centre pixel sees `centre` to within some hundred metres."""
    pitch = 0.0
    for _ in range(8):
        model = scenes.build(SHAPE, pitch_deg=pitch, orbit=later_orbit(25.0)).model()
        seen = model.image_to_ground(np.array([999.5, 749.5]), 500.0).geodetic
        step = 1e-3
        other = scenes.build(SHAPE, pitch_deg=pitch + step, orbit=later_orbit(25.0)).model()
        moved = other.image_to_ground(np.array([999.5, 749.5]), 500.0).geodetic
        slope = (moved[:2] - seen[:2]) / step
        pitch += float(slope @ (centre[:2] - seen[:2]) / (slope @ slope))
    return model


def later_orbit(seconds: float) -> scenes.Orbit:
    """The scenes' orbit, entered `seconds` later."""
    orbit = scenes.Orbit.over(0.2, 0.75)
    return orbit.later(seconds)
