"""The tables of T chapter 4: the bound's known figures, and ours at it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from geoposition.scripts.experiments import thesis_ch4
from geoposition.scripts.experiments.monte_carlo import ARCSEC_RAD, without_noise
from geoposition.scripts.experiments.thesis_tables import ThesisCh4, parameter_vector
from geoposition.scripts.results import plain
from geoposition.sensors.attitude_determination.monte_carlo.bound import bound_rms_rad

RUNS = 24


@pytest.fixture(scope="module")
def tables() -> ThesisCh4:
    return thesis_ch4.run(RUNS, seed=3, graph_runs=2)


def test_bounds_are_the_known_ones() -> None:
    truth = parameter_vector(thesis_ch4.TRUTH)
    general = without_noise(thesis_ch4.scene(), thesis_ch4.TRUTH)
    forward, smoothed = bound_rms_rad(general, thesis_ch4.GENERAL, truth)
    np.testing.assert_allclose(forward / ARCSEC_RAD, 0.855, rtol=0.005)
    np.testing.assert_allclose(smoothed / ARCSEC_RAD, 0.452, rtol=0.002)
    simple = without_noise(thesis_ch4.scene(), thesis_ch4.BIAS_ONLY)
    forward, smoothed = bound_rms_rad(simple, thesis_ch4.SIMPLE, truth[:3])
    np.testing.assert_allclose(forward / ARCSEC_RAD, 0.706, rtol=0.01)
    np.testing.assert_allclose(smoothed / ARCSEC_RAD, 0.448, rtol=0.002)


def test_methods_reach_their_expectation(tables: ThesisCh4) -> None:
    for row in tables.rms:
        if row.expected is None or row.method == "graph":
            continue
        # Three axes of RUNS runs: the scatter of their common mean square.
        ratio = np.mean(np.square(row.rms)) / np.mean(np.square(row.expected))
        spread = 2.0 * np.mean(row.scatter) / np.mean(row.rms) / np.sqrt(3 * RUNS)
        assert abs(ratio - 1.0) < 4.0 * spread, row


def test_methods_agree_and_the_simple_model_fails(tables: ThesisCh4) -> None:
    assert tables.agreement["two-filter/rts"] < 1e-8
    assert tables.agreement["graph/rts"] < 0.01
    assert min(tables.as_json()["simple_model_error_arcsec"]) > 40.0


def test_gyro_parameters_are_found_within_their_sigmas(tables: ThesisCh4) -> None:
    for row in tables.parameters:
        assert abs(row.mean - row.truth) < 4.0 * row.sigma / np.sqrt(RUNS), row
        assert row.within_3_sigma > 0.9
        assert 0.5 < row.rms / row.sigma < 1.6
    ppm = [row.sigma for row in tables.parameters if row.name.endswith("_ppm")]
    assert max(ppm) < 12.0


def test_json_has_the_contracts_keys(tables: ThesisCh4) -> None:
    found = json.loads(json.dumps(plain(tables.as_json())))
    for key in ("rms_arcsec", "bound_arcsec"):
        assert {"ekf-6", "ekf-15", "rts", "two-filter", "graph"} <= set(found[key])
        assert all(len(axes) == 3 for axes in found[key].values())
    assert all(
        set(entry) == {"truth", "mean", "sigma"} for entry in found["gyro_parameters"].values()
    )
    assert len(found["gyro_parameters"]) == 12
    assert {"4.2", "4.3", "4.4", "4.5", "4.6", "4.7", "4.8", "4.9", "4.10"} <= set(found["tables"])


def test_tables_say_how_far_along_they_are() -> None:
    seen: list[tuple[int, int]] = []
    thesis_ch4.run(2, graph_runs=0, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1][0] == seen[-1][1]
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
