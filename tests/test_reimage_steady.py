"""Steady attitude: jitter out, everything else in; and what the spectrum of it says."""

from __future__ import annotations

import numpy as np
import pytest
import scenes
from scipy.spatial.transform import Rotation

from geoposition.arrays import FloatArray
from geoposition.attitude import Attitude
from geoposition.errors import ArgumentError, GeometryError, SpanError
from geoposition.reimage.sinusoids import amplitude_spectrum, strongest
from geoposition.reimage.steady import SteadyOptions, steady_attitude, steady_model
from geoposition.rpc.fit import fit_model

ARCSEC = np.pi / 648000.0
ORBIT = scenes.Orbit.over(0.2, 0.75)


def attitude_with(turn_rad: FloatArray, times: FloatArray) -> scenes.Scene:
    """A scene whose body shakes by rotation vectors `turn_rad` (n, 3) around nadir."""
    scene = scenes.build((2000, 400), roll_deg=8.0, spare_s=12.0)
    quat = (ORBIT.R_ecef_nadir(times) * Rotation.from_rotvec(turn_rad)).as_quat()
    shaken = Attitude.from_samples(scenes.EPOCH, times, quat, "itrs", "spline")
    return scenes.replace(scene, attitude=shaken)


def test_pointing_at_the_earth_is_left_alone() -> None:
    scene = scenes.build((2000, 400), roll_deg=8.0, pitch_deg=12.0, spare_s=4.0)
    for options in (SteadyOptions(), SteadyOptions("low-pass", cutoff_hz=1.0)):
        _, removed = steady_model(scene.model(), options)
        # slerp of samples 20 ms apart against an orbit that turns by a milliradian a second
        assert np.abs(removed.removed_rad).max() < 2e-9


@pytest.mark.parametrize("method", ["polynomial", "low-pass", "spline"])
def test_jitter_is_removed_and_kept(method: str) -> None:
    times = np.arange(-8.0, 8.0, 0.002)
    jitter = np.zeros((len(times), 3))
    jitter[:, 0] = 2 * ARCSEC * np.sin(2 * np.pi * 60.0 * times + 0.3)
    jitter[:, 1] = 1 * ARCSEC * np.sin(2 * np.pi * 85.0 * times)
    scene = attitude_with(jitter, times)
    cutoff = None if method == "polynomial" else 2.0
    options = SteadyOptions(method, cutoff_hz=cutoff)  # type: ignore[arg-type]
    found = steady_attitude(scene.attitude, scene.ephemeris, (-1.0, 1.0), options)
    wanted = np.stack([np.interp(found.times_s, times, jitter[:, k]) for k in range(3)], axis=-1)
    miss = found.removed_rad - wanted
    # interpolating the samples linearly for `wanted` is worth 2 %
    assert np.sqrt(np.mean(miss**2)) < 0.06 * ARCSEC
    removed = np.array(found.removed_rad)
    whole = (found.attitude.rotation(found.times_s) * Rotation.from_rotvec(removed)).inv()
    assert (whole * scene.attitude.rotation(found.times_s)).magnitude().max() < 1e-12


@pytest.mark.parametrize(("frequency", "gain"), [(0.25, 1.0), (1.0, 0.5), (4.0, 0.0)])
def test_a_low_pass_has_half_gain_at_its_cutoff_and_no_phase(frequency: float, gain: float) -> None:
    times = np.arange(-12.0, 12.0, 0.01)
    jitter = np.zeros((len(times), 3))
    jitter[:, 0] = 3 * ARCSEC * np.cos(2 * np.pi * frequency * times + 0.7)
    scene = attitude_with(jitter, times)
    options = SteadyOptions("low-pass", cutoff_hz=1.0)
    found = steady_attitude(scene.attitude, scene.ephemeris, (-2.0, 2.0), options)
    angle = 2 * np.pi * frequency * found.times_s + 0.7
    design = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=-1)
    kept = np.linalg.lstsq(design, found.removed_rad[:, 0], rcond=None)[0] / (3 * ARCSEC)
    assert 1.0 - kept[0] == pytest.approx(gain, abs=0.01)
    assert kept[1] == pytest.approx(0.0, abs=0.01)


def test_an_rpc_follows_the_steady_model_only() -> None:
    jitter = (scenes.Jitter(0, 3e-6, 20.0), scenes.Jitter(1, 2e-6, 33.0, 1.0))
    scene = scenes.build((3000, 800), jitter=jitter, attitude_step_s=0.002, spare_s=1.0)
    model = scene.model()
    steady, _ = steady_model(model)
    before = fit_model(model, (0.0, 2000.0), limit_px=np.inf, direct=False).check
    after = fit_model(steady, (0.0, 2000.0)).check
    assert before is not None
    assert after is not None
    assert before.largest_px > 1.0
    assert after.largest_px < 2e-4
    assert steady.covered_lines == pytest.approx(model.covered_lines, abs=1e-3)


def test_a_manoeuvre_is_followed_by_a_polynomial_of_its_degree() -> None:
    times = np.arange(-3.0, 3.0, 0.01)
    slow = np.stack([1e-3 * times**2, 5e-4 * times**3, 1e-4 * times], axis=-1)
    scene = attitude_with(slow, times)
    cubic = steady_attitude(scene.attitude, scene.ephemeris, (-1.0, 1.0), SteadyOptions(degree=3))
    line = steady_attitude(scene.attitude, scene.ephemeris, (-1.0, 1.0), SteadyOptions(degree=1))
    assert np.abs(cubic.removed_rad).max() < 0.05 * np.abs(line.removed_rad).max()


def test_what_makes_no_sense_is_refused() -> None:
    scene = scenes.build((500, 200))
    with pytest.raises(ArgumentError, match="cut-off"):
        SteadyOptions("low-pass")
    with pytest.raises(ArgumentError, match="no cut-off"):
        SteadyOptions(cutoff_hz=1.0)
    with pytest.raises(ArgumentError, match="polynomial, low-pass or spline"):
        SteadyOptions("mean")  # type: ignore[arg-type]
    slow, fast = (SteadyOptions("low-pass", cutoff_hz=hz) for hz in (0.001, 5000.0))
    with pytest.raises(GeometryError, match="too short"):
        steady_attitude(scene.attitude, scene.ephemeris, (-0.1, 0.1), slow)
    with pytest.raises(GeometryError, match="above what samples"):
        steady_attitude(scene.attitude, scene.ephemeris, (-0.1, 0.1), fast)
    with pytest.raises(SpanError):
        steady_attitude(scene.attitude, scene.ephemeris, (1e3, 2e3))


def test_lines_have_the_uncertainty_they_state() -> None:
    rng = np.random.default_rng(7)
    times = np.arange(1500) * 1e-3
    f, a, phase, noise = 41.37, 0.3, 0.8, 0.2
    normed = []
    for _ in range(60):
        values = a * np.cos(2 * np.pi * f * times + phase) + noise * rng.standard_normal(1500)
        values[200:260] = np.nan
        line = strongest(times, values, 1)[0]
        normed.append(
            [
                (line.frequency_hz - f) / line.sigma_frequency_hz,
                (line.amplitude - a) / line.sigma_amplitude,
                np.angle(np.exp(1j * (line.phase_rad - phase))) / line.sigma_phase_rad,
            ]
        )
    spread = np.sqrt(np.mean(np.square(normed), axis=0))
    assert spread == pytest.approx(np.ones(3), abs=0.3)


def test_lines_close_together_and_noise_alone() -> None:
    rng = np.random.default_rng(8)
    times = np.arange(2000) * 1e-3
    both = np.cos(2 * np.pi * 50.0 * times) + 0.5 * np.cos(2 * np.pi * 52.0 * times + 1.0)
    lines = strongest(times, both + 0.01 * rng.standard_normal(2000), 4)
    assert [line.frequency_hz for line in lines[:2]] == pytest.approx([50.0, 52.0], abs=1e-3)
    assert lines[0].at(times) + lines[1].at(times) == pytest.approx(both, abs=0.01)
    assert strongest(times, rng.standard_normal(2000), 4, significance=6.0) == ()
    with pytest.raises(ArgumentError, match="at least 16"):
        strongest(times, np.full(2000, np.nan), 1)


def test_the_spectrum_has_the_lines_own_amplitude() -> None:
    times = np.arange(1000) * 1e-3
    frequency, amplitude = amplitude_spectrum(times, 3.0 * np.cos(2 * np.pi * 80 * times)[:, None])
    at = int(np.argmax(amplitude[:, 0]))
    assert frequency[at] == pytest.approx(80.0, abs=0.1)
    assert amplitude[at, 0] == pytest.approx(3.0, rel=0.01)
