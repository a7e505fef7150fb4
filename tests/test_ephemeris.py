"""Ephemeris: interpolation against Kepler, and the velocity trap of the Pleiades products."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import EARTH_RATE, EPOCH, Orbit

from geoposition.ephemeris import Ephemeris, earth_fixed_velocity, velocity_kind
from geoposition.errors import ArgumentError, SpanError

ORBIT = Orbit.over(0.2, 0.75, 700e3, eccentricity=0.002)
COARSE = np.arange(-210.0, 211.0, 30.0)
FINE = np.arange(-20.0, 21.0)
AT = np.linspace(-15.0, 15.0, 301)


def inertial_on_itrs_axes(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    position, velocity = ORBIT.earth_fixed(t)
    return position, velocity + np.cross(EARTH_RATE, position)


def worst(ephemeris: Ephemeris) -> tuple[float, float]:
    position, velocity = ORBIT.earth_fixed(AT)
    return (
        float(np.abs(ephemeris.position_m(AT) - position).max()),
        float(np.abs(ephemeris.velocity_m_s(AT) - velocity).max()),
    )


def test_the_orbit_of_the_scenes_is_kepler() -> None:
    # The authority of the tests below: its velocity is its rate, its energy and momentum stay.
    t, step = np.linspace(-3000, 3000, 61), 0.05
    for orbit in (ORBIT, Orbit(26600e3, 0.74, 1.1, 0.2, 0.3, 0.02)):
        for motion in (orbit.inertial, orbit.earth_fixed):
            rate = (motion(t + step)[0] - motion(t - step)[0]) / (2 * step)
            assert np.abs(rate - motion(t)[1]).max() < 1e-4
        position, velocity = orbit.inertial(t)
        r = np.linalg.norm(position, axis=-1)
        energy = 0.5 * np.sum(velocity**2, axis=-1) - 3.986004418e14 / r
        assert np.ptp(energy) < 1e-8 * np.abs(energy).max()
        assert np.ptp(np.cross(position, velocity), axis=0).max() < 1e-8 * r.max() * 1e4
    assert np.abs(ORBIT.inertial(0.0)[0] - ORBIT.earth_fixed(0.0)[0]).max() < 1e-6


def test_lagrange_on_30_s_samples() -> None:
    # Pleiades: 30 s samples, 8 points. Error ~ r (n dt)^8 / 300: micrometres.
    position, velocity = worst(Ephemeris.lagrange(EPOCH, COARSE, ORBIT.earth_fixed(COARSE)[0]))
    assert position < 1e-4
    assert velocity < 1e-5


def test_hermite_and_spline_on_1_s_samples() -> None:
    samples = ORBIT.earth_fixed(FINE)
    # Hermite: r n^4 dt^4 / 384 = 23 nm; a spline has four times that inside.
    assert worst(Ephemeris.hermite(EPOCH, FINE, *samples))[0] < 4e-8
    assert worst(Ephemeris.spline(EPOCH, FINE, samples[0]))[0] < 1e-7


def test_polynomial_of_enough_degrees() -> None:
    samples = ORBIT.earth_fixed(FINE)[0]
    assert worst(Ephemeris.polynomial(EPOCH, FINE, samples, 8))[0] < 1e-6
    # The quadratic of T 2.7 leaves r (n t)^3 / 6 / 4: metres over 40 s.
    assert 0.1 < worst(Ephemeris.polynomial(EPOCH, FINE, samples))[0] < 50


def test_velocity_kinds() -> None:
    for t in (FINE, COARSE, np.arange(-100.0, 101.0, 10.0)):
        assert velocity_kind(t, *ORBIT.earth_fixed(t)) == "earth-fixed"
        assert velocity_kind(t, *inertial_on_itrs_axes(t)) == "inertial-on-itrs-axes"
        position, velocity = ORBIT.earth_fixed(t)
        assert velocity_kind(t, position, 1.001 * velocity) == "inconsistent"
        assert velocity_kind(t, position, -velocity) == "inconsistent"
        assert velocity_kind(t, position, velocity * [1, 1, np.nan]) == "inconsistent"
        assert velocity_kind(t, position * 1e-3, velocity * 1e-3 + 1) == "inconsistent"
        # Kilometres a second beside metres.
        assert velocity_kind(t, position, velocity * 1e-3) == "inconsistent"


def test_hermite_refuses_the_pleiades_trap() -> None:
    with pytest.raises(ArgumentError, match="inertial-on-itrs-axes"):
        Ephemeris.hermite(EPOCH, COARSE, *inertial_on_itrs_axes(COARSE))
    position, velocity = ORBIT.earth_fixed(COARSE)
    with pytest.raises(ArgumentError, match="inconsistent"):
        Ephemeris.hermite(EPOCH, COARSE, position, 1.01 * velocity)
    position, velocity = inertial_on_itrs_axes(COARSE)
    right = Ephemeris.hermite(EPOCH, COARSE, position, earth_fixed_velocity(position, velocity))
    # r (n dt)^4 / 384 at 30 s: 18 mm.
    assert worst(right)[0] < 0.04


def test_what_the_trap_would_cost() -> None:
    # Bent in between to fit slopes that are not its own: dt / 8 x the difference of the error's
    # ends, some metres here, and 470 m/s in velocity at the samples.
    from geoposition.interpolation import SplineCurve

    wrong = Ephemeris(EPOCH, SplineCurve.hermite(COARSE, *inertial_on_itrs_axes(COARSE)))
    assert worst(wrong)[0] > 5.0
    assert worst(wrong)[1] > 100.0


def test_earth_fixed_velocity() -> None:
    position, velocity = inertial_on_itrs_axes(FINE)
    back = earth_fixed_velocity(position, velocity)
    assert np.abs(back - ORBIT.earth_fixed(FINE)[1]).max() < 1e-9


def test_velocity_is_the_rate_in_gcrs_too() -> None:
    position, velocity = ORBIT.gcrs(FINE)
    ephemeris = Ephemeris.hermite(EPOCH, FINE, position, velocity, "gcrs")
    assert ephemeris.frame == "gcrs"
    middle = ephemeris.position_m(FINE[:-1] + 0.5) - ORBIT.gcrs(FINE[:-1] + 0.5)[0]
    assert np.abs(middle).max() < 1e-6


def test_span() -> None:
    ephemeris = Ephemeris.lagrange(EPOCH, FINE, ORBIT.earth_fixed(FINE)[0])
    assert ephemeris.span_s == (-20.0, 20.0)
    for bad in (-20.1, 20.1, np.nan, [0.0, 21.0]):
        with pytest.raises(SpanError):
            ephemeris.position_m(bad)
        with pytest.raises(SpanError):
            ephemeris.velocity_m_s(bad)


def test_unusable_input() -> None:
    position, velocity = ORBIT.earth_fixed(FINE)
    with pytest.raises(ArgumentError):
        Ephemeris.hermite(EPOCH, FINE, position[:, :2], velocity)
    with pytest.raises(ArgumentError):
        Ephemeris.hermite(EPOCH, FINE, position[:-1], velocity)
    with pytest.raises(ArgumentError):
        Ephemeris.hermite(EPOCH, FINE, position, velocity[:-1])
    with pytest.raises(ArgumentError, match="increasing"):
        Ephemeris.hermite(EPOCH, FINE[::-1], position, velocity)
    for make in (Ephemeris.lagrange, Ephemeris.spline, Ephemeris.polynomial):
        with pytest.raises(ArgumentError):
            make(EPOCH, FINE, position[:, :2])
        with pytest.raises(ArgumentError, match="increasing"):
            make(EPOCH, np.zeros(41), position)
