"""Jitter from attitude, rates and increments: injected lines come back on the right axes."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geoposition.ephemeris import Ephemeris
from geoposition.errors import ArgumentError, SpanError
from geoposition.sensors.attitude_determination.jitter.lines import (
    AXES,
    Jitter,
    JitterSettings,
    jitter_from_attitude,
    jitter_from_gyro,
)
from geoposition.sensors.attitude_determination.jitter.orbit_angles import orbit_roll_pitch_yaw
from geoposition.sensors.simulate_attitude import Pointing, Vibration
from geoposition.sensors.simulate_orbit import Orbit
from geoposition.sensors.telemetry import GyroKind, GyroSeries
from geoposition.timescale import Epoch

ARCSEC = np.pi / 648000.0
EPOCH = Epoch.from_utc("2012-02-03T02:00:00")
ORBIT = Orbit.over(EPOCH, 2.0, 0.5, 506e3, np.radians(97.42))


def vibration(frequency_hz: float, arcsec: tuple[float, float, float]) -> Vibration:
    return Vibration(frequency_hz, np.array(arcsec) * ARCSEC, np.array([0.3, 1.0, -2.0]))


def ephemeris(first_s: float, last_s: float, frame: str) -> Ephemeris:
    times = np.arange(first_s - 20.0, last_s + 20.0)
    position, velocity = ORBIT.states(times)
    if frame == "gcrs":
        return Ephemeris.lagrange(EPOCH, times, position, "gcrs")
    from geoposition.frames import itrs_from_gcrs

    return Ephemeris.lagrange(EPOCH, times, itrs_from_gcrs(position, velocity, EPOCH, times)[0])


def found_lines(jitter: Jitter) -> dict[str, list[tuple[float, float]]]:
    return {
        axis: [(round(p.frequency_hz, 2), p.amplitude_rad / ARCSEC) for p in jitter.axes[axis]]
        for axis in AXES
    }


@pytest.mark.parametrize("frame", ["gcrs", "itrs"])
def test_zy3_jitter_of_star_attitude_in_the_orbit_frame(frame: str) -> None:
    # 4 Hz for 5 minutes, 4" at 0.65 Hz in roll and pitch, attitude noise of 2".
    rng = np.random.default_rng(1)
    times = np.arange(0.0, 300.0, 0.25)
    pointing = Pointing(roll_rad=0.1, vibrations=(vibration(0.65, (4.0, 3.0, 0.0)),))
    noise = Rotation.from_rotvec(2.0 * ARCSEC * rng.standard_normal((len(times), 3)))
    attitude = pointing.R_gcrs_body(ORBIT, times) * noise
    found = jitter_from_attitude(times, attitude, ephemeris(0.0, 300.0, frame))
    lines = found_lines(found)
    assert lines["roll"] == [(0.65, pytest.approx(4.0, abs=0.4))]
    assert lines["pitch"] == [(0.65, pytest.approx(3.0, abs=0.4))]
    assert lines["yaw"] == []
    (roll,) = found.axes["roll"]
    assert abs(roll.amplitude_rad - 4.0 * ARCSEC) < 4.0 * roll.sigma_amplitude_rad
    assert abs(roll.phase_rad - 0.3) < 4.0 * roll.sigma_phase_rad
    assert abs(roll.frequency_hz - 0.65) < 4.0 * roll.sigma_frequency_hz


def test_orbit_angles_are_those_that_were_commanded() -> None:
    times = np.arange(0.0, 120.0, 0.5)
    pointing = Pointing(roll_rad=0.2, pitch_rad=-0.05, yaw_rad=0.02, yaw_steering=False)
    attitude = pointing.R_gcrs_body(ORBIT, times)
    angles = orbit_roll_pitch_yaw(times, attitude, ephemeris(0.0, 120.0, "gcrs"))
    np.testing.assert_allclose(angles, np.tile([0.2, -0.05, 0.02], (len(times), 1)), atol=1e-9)


def test_axes_named_otherwise_are_measured_from_the_mean() -> None:
    # Body X down: no orbit frame is near, and pitch would be singular.
    times = np.arange(0.0, 200.0, 0.1)
    pointing = Pointing(yaw_steering=False, vibrations=(vibration(1.0, (2.0, 0.0, 0.0)),))
    odd = pointing.R_gcrs_body(ORBIT, times) * Rotation.from_euler("y", 90, degrees=True)
    noise = 0.1 * ARCSEC * np.random.default_rng(2).standard_normal((len(times), 3))
    found = jitter_from_attitude(
        times, odd * Rotation.from_rotvec(noise), ephemeris(0.0, 200.0, "gcrs")
    )
    assert found_lines(found)["roll"] == [(1.0, pytest.approx(2.0, rel=0.02))]


def test_without_an_orbit_the_body_angles_are_used() -> None:
    rng = np.random.default_rng(3)
    times = np.arange(0.0, 430.0, 0.2)
    pointing = Pointing(vibrations=(vibration(0.73, (3.0, 0.0, 1.0)),))
    noise = Rotation.from_rotvec(0.5 * ARCSEC * rng.standard_normal((len(times), 3)))
    found = jitter_from_attitude(times, pointing.R_gcrs_body(ORBIT, times) * noise)
    lines = found_lines(found)
    assert lines["roll"] == [(0.73, pytest.approx(3.0, abs=0.1))]
    assert lines["pitch"] == []
    assert lines["yaw"] == [(0.73, pytest.approx(1.0, abs=0.1))]


def test_lro_like_series_of_uneven_steps() -> None:
    # Lines at 0.73 and 1.35 Hz in steps of 0.1 and 0.2 s: both found, and nothing else.
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.choice([0.1, 0.2], 2500, p=[0.07, 0.93]))
    pointing = Pointing(
        vibrations=(vibration(0.73, (1.0, 2.0, 0.5)), vibration(1.35, (0.6, 0.3, 1.0)))
    )
    noise = Rotation.from_rotvec(0.4 * ARCSEC * rng.standard_normal((len(times), 3)))
    found = found_lines(jitter_from_attitude(times, pointing.R_gcrs_body(ORBIT, times) * noise))
    for axis in AXES:
        assert sorted(f for f, _ in found[axis]) == [0.73, 1.35]
    assert dict(found["pitch"]) == pytest.approx({0.73: 2.0, 1.35: 0.3}, abs=0.08)


@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
@pytest.mark.parametrize("frequency_hz", [0.5, 2.0, 4.0])
def test_transfer_of_every_kind_of_gyro(kind: GyroKind, frequency_hz: float) -> None:
    # Near the Nyquist frequency of 5 Hz means and increments lose a third of the line.
    step = 0.1
    times = np.arange(0.0, 300.0, step)
    omega, phase = 2.0 * np.pi * frequency_hz, 0.7
    amplitude = np.array([3.0, 2.0, 1.0]) * ARCSEC
    angle = np.sin(omega * times + phase)[:, None] * amplitude
    before = np.sin(omega * (times - step) + phase)[:, None] * amplitude
    values = {
        "rate": omega * np.cos(omega * times + phase)[:, None] * amplitude,
        "mean-rate": (angle - before) / step,
        "increment": angle - before,
    }[kind]
    bias = np.array([1e-5, -1e-3, 2e-5]) * (step if kind == "increment" else 1.0)
    noise = 1e-3 * np.abs(values).max() * np.random.default_rng(5).standard_normal(values.shape)
    found = jitter_from_gyro(GyroSeries.of(times, values + bias + noise, kind))
    for i, axis in enumerate(AXES):
        peak = found.axes[axis][0]
        assert peak.frequency_hz == pytest.approx(frequency_hz, abs=1e-4)
        assert peak.amplitude_rad == pytest.approx(amplitude[i], rel=2e-3)
        at_reference = phase + omega * (found.reference_s - times[0])
        assert abs(np.angle(np.exp(1j * (peak.phase_rad - at_reference)))) < 0.01
        best = np.argmax(found.spectrum.density[:, i])
        assert found.spectrum.amplitude()[best, i] == pytest.approx(amplitude[i], rel=0.2)
        # No spline through sampled rates follows a line at 0.8 of the Nyquist frequency.
        if kind != "rate" or frequency_hz < 4.0:
            drawn = np.std(found.angle_rad[100:-100, i])
            assert drawn == pytest.approx(amplitude[i] / np.sqrt(2.0), rel=0.1)


def test_angular_displacement_of_the_paper() -> None:
    """P figures 3 and 4: 10 kHz for 60 s; amplitudes to 2 %, frequencies to 0.05 Hz, in time."""
    rng = np.random.default_rng(6)
    n, step = 600_000, 1e-4
    times = np.arange(n) * step
    truth = {
        "roll": {200.0: 0.020, 300.0: 0.020, 350.0: 0.015},
        "pitch": {200.0: 0.025, 300.0: 0.025, 350.0: 0.020},
        "yaw": {200.0: 0.006, 300.0: 0.006, 350.0: 0.006},
    }
    angle = np.stack(
        [
            sum(a * np.sin(2 * np.pi * f * times + i) for f, a in truth[axis].items())
            for i, axis in enumerate(AXES)
        ],
        axis=1,
    )
    increments = np.diff(angle, axis=0, prepend=angle[:1])
    increments += 0.015 * np.sqrt(step) * rng.standard_normal((n, 3))  # angle random walk
    increments += np.array([0.1, -225.0, 0.5]) * step  # drift, orbital turn
    gyro = GyroSeries.of(times, increments * ARCSEC, "increment")
    spent = []
    for _ in range(3):
        started = time.process_time()
        found = jitter_from_gyro(gyro)
        spent.append(time.process_time() - started)
    for axis in AXES:
        peaks = {round(p.frequency_hz): p for p in found.axes[axis]}
        assert sorted(peaks) == [200, 300, 350]
        for frequency, amplitude in truth[axis].items():
            peak = peaks[round(frequency)]
            assert peak.frequency_hz == pytest.approx(frequency, abs=0.05)
            assert peak.amplitude_rad / ARCSEC == pytest.approx(amplitude, abs=0.02 * 0.025)
            assert abs(peak.amplitude_rad / ARCSEC - amplitude) < 4.5 * (
                peak.sigma_amplitude_rad / ARCSEC
            )
    # 1.1 s on two quiet cores; processor time, so that busy ones do not count.
    assert min(spent) < 6.0


def test_noise_and_motion_alone_show_nothing() -> None:
    lines = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        times = np.arange(0.0, 300.0, 0.25)
        noise = Rotation.from_rotvec(2.0 * ARCSEC * rng.standard_normal((len(times), 3)))
        attitude = Pointing(roll_rad=0.1).R_gcrs_body(ORBIT, times) * noise
        lines += sum(len(peaks) for peaks in jitter_from_attitude(times, attitude).axes.values())
    assert lines <= 1  # expected: 20 × 3 × 0.001


def test_spectrum_and_summary() -> None:
    rng = np.random.default_rng(7)
    times = np.arange(0.0, 600.0, 0.1)
    rates = 1e-6 * rng.standard_normal((len(times), 3))
    rates[:, 1] += 2e-5 * np.sin(2 * np.pi * 1.0 * times)
    found = jitter_from_gyro(GyroSeries.of(times, rates), JitterSettings(low_cut_hz=0.05))
    summary = found.summary()
    (pitch,) = summary["axes"]["pitch"]
    assert pitch["frequency_hz"] == pytest.approx(1.0, abs=1e-3)
    assert pitch["amplitude_arcsec"] == pytest.approx(2e-5 / (2 * np.pi) / ARCSEC, rel=0.01)
    assert summary["low_cut_hz"] == 0.05
    best = np.argmax(found.spectrum.density[:, 1])
    assert found.spectrum.frequency_hz[best] == pytest.approx(1.0, abs=0.02)
    assert found.spectrum.amplitude()[best, 1] == pytest.approx(2e-5 / (2 * np.pi), rel=0.2)


def test_what_cannot_be_searched_is_refused() -> None:
    times = np.arange(0.0, 100.0, 0.25)
    attitude = Pointing().R_gcrs_body(ORBIT, times)
    with pytest.raises(ArgumentError, match="at least 64"):
        jitter_from_attitude(times[:20], attitude[:20])
    with pytest.raises(ArgumentError, match="nothing to search"):
        jitter_from_attitude(times, attitude, settings=JitterSettings(low_cut_hz=1.5))
    with pytest.raises(ArgumentError, match="rotations expected"):
        jitter_from_attitude(times, attitude[:10])
    with pytest.raises(SpanError):
        jitter_from_attitude(times, attitude, ephemeris(0.0, 50.0, "gcrs"))
    with pytest.raises(ArgumentError, match="positive frequencies"):
        JitterSettings(low_cut_hz=-1.0)
