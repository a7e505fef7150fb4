"""Jitter from overlapping CCDs: simulated images of a staggered focal plane give it back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scenes

from geoposition.calib_fields.synthetic import fractal_field
from geoposition.reimage.jitter_parallax import JitterLine, compared, jitter_of, parallax_gain
from geoposition.reimage.mapping import map_models
from geoposition.reimage.parallax import Parallax, measure_parallax
from geoposition.reimage.resample import Resampler
from geoposition.reimage.sinusoids import Sinusoid, strongest
from geoposition.reimage.steady import steady_model
from geoposition.reimage.virtual import ideal_camera, single_ccd

GSD_M, ALTITUDE_M = 0.7, 600e3
IFOV = GSD_M / ALTITUDE_M
FREQUENCY_HZ = 37.3
AMPLITUDE_PX = 0.3
LINES = 3000


@pytest.fixture(scope="module")
def told() -> tuple[Parallax, dict[str, Sinusoid]]:
    """The parallax measured, and the jitter's line as the true models have it in the image.

    Two CCDs of 300 pixels, 200 in common, 60 lines apart; 0.3 px of roll and pitch.
    """
    ccds = scenes.focal_plane(2, 300, IFOV, overlap_px=200, stagger_px=60)
    jitter = tuple(
        scenes.Jitter(axis, AMPLITUDE_PX * IFOV, FREQUENCY_HZ, phase)
        for axis, phase in ((0, 0.4), (1, 1.1))
    )
    scene = scenes.build(
        (LINES, 600), ccds=ccds, gsd_m=GSD_M, jitter=jitter, attitude_step_s=0.0005,
        attitude="spline", spare_s=1.0,
    )  # fmt: skip
    taken = scene.model()
    steady, _ = steady_model(taken)
    wide = replace(steady, camera=ideal_camera(steady.camera)[0])
    rng = np.random.default_rng(5)
    ground = fractal_field((LINES, wide.shape[1]), (1.0, 1.0), 5.0, 1.6, rng)
    texture = (200.0 + 1600.0 * ground).astype(np.float32)[None]
    images = []
    for number in range(2):
        mapping = map_models(single_ccd(taken, number), wide, 300.0)
        pixels, valid = Resampler("lanczos").rows(texture, mapping.rows(0, LINES), 300)
        noise = rng.normal(0.0, 4.0, pixels[0].shape)
        images.append(np.where(valid != 0, pixels[0], 0.0) + noise)
    first = single_ccd(steady, 0)
    truth = map_models(first, single_ccd(taken, 0), 300.0).rows(0, LINES)
    moved = truth.displacement_px(np.array([150.0]))[:, 0]
    times = first.camera.timing.time_s(np.arange(LINES))
    line = {axis: strongest(times, moved[:, k], 1)[0] for k, axis in enumerate(("line", "sample"))}
    return measure_parallax(first, single_ccd(steady, 1), images[0], images[1], 300.0), line


def test_the_jitter_is_found_again(told: tuple[Parallax, dict[str, Sinusoid]]) -> None:
    parallax, truth = told
    lines = jitter_of(parallax, count=1)
    assert {line.axis for line in lines} == {"line", "sample"}
    for found in lines:
        true = truth[found.axis]
        assert true.amplitude == pytest.approx(AMPLITUDE_PX, rel=0.05)
        assert found.line.frequency_hz == pytest.approx(FREQUENCY_HZ, rel=0.0005)
        assert found.line.amplitude == pytest.approx(true.amplitude, rel=0.02)
        assert np.cos(found.line.phase_rad - true.phase_rad) > np.cos(0.03)
        assert found.line.sigma_frequency_hz < 0.001 * FREQUENCY_HZ
        assert found.amplitude_rad(IFOV) == pytest.approx(AMPLITUDE_PX * IFOV, rel=0.05)


def test_the_lag_is_the_staggers(told: tuple[Parallax, dict[str, Sinusoid]]) -> None:
    parallax = told[0]
    step = float(np.median(np.diff(parallax.times_s)))
    assert abs(parallax.lag_s) == pytest.approx(60 * step / 4, rel=0.1)


def test_a_lines_gain_and_phase_are_undone_in_closed_form() -> None:
    lag, f, amplitude, phase = 0.011, 61.0, 0.7, -1.3
    times = np.arange(4000) * 2.5e-4

    def jitter(t: np.ndarray) -> np.ndarray:
        return amplitude * np.cos(2 * np.pi * f * t + phase)

    shift = np.stack([jitter(times + lag) - jitter(times), np.zeros_like(times)], axis=-1)
    rng = np.random.default_rng(0)
    shift += rng.normal(0.0, 1e-3, shift.shape)
    found = jitter_of(Parallax(times, shift, np.ones_like(shift), lag, 0.0), count=1)
    line = next(item for item in found if item.axis == "line").line
    assert line.amplitude == pytest.approx(amplitude, abs=5 * line.sigma_amplitude)
    assert line.phase_rad == pytest.approx(phase, abs=5 * line.sigma_phase_rad)
    assert line.sigma_amplitude < 1e-3


def test_blind_frequencies_are_not_reported() -> None:
    lag = 0.01
    assert parallax_gain(100.0, lag) == pytest.approx(0.0, abs=1e-12)
    times = np.arange(2000) * 5e-4
    shift = np.zeros((2000, 2))
    shift[:, 0] = 0.1 * np.cos(2 * np.pi * 100.2 * times)
    shift += np.random.default_rng(1).normal(0.0, 1e-3, shift.shape)
    found = jitter_of(Parallax(times, shift, np.ones_like(shift), lag, 0.0), count=1)
    assert not [item for item in found if abs(item.line.frequency_hz - 100.2) < 1.0]


def test_lines_of_several_sources_stand_beside_each_other() -> None:
    def line(f: float, a: float) -> Sinusoid:
        return Sinusoid(f, a, 0.0, 0.01, 0.01, 0.01)

    rows = compared(
        {"attitude": [line(100.0, 1.0), line(20.0, 0.2)], "images": [line(100.3, 0.9)]}, 0.5
    )
    assert [row.frequency_hz for row in rows] == [100.0, 20.0]
    images = [row.by_source["images"] for row in rows]
    assert images[0] is not None
    assert images[0].amplitude == 0.9
    assert images[1] is None
    assert isinstance(JitterLine("line", line(1.0, 1.0), 2.0).amplitude_rad(1e-6), float)
