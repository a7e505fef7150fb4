"""T tables 3.2–3.4: near the bound where optimal, honest where not."""

from __future__ import annotations

import numpy as np
import pytest

from geoposition.errors import ArgumentError
from geoposition.scripts.experiments import thesis_ch3
from geoposition.scripts.results import plain


@pytest.fixture(scope="module")
def found() -> thesis_ch3.Chapter3:
    return thesis_ch3.run(60, seed=1)


def test_bound_is_the_known_one() -> None:
    bound = thesis_ch3.bounds()
    # Covariance analysis of table 3.1 with a drift prior of 1 deg/h, done elsewhere: 0.72, 0.347.
    np.testing.assert_allclose(bound["ekf-6"], 0.73, atol=0.015)
    np.testing.assert_allclose(bound["rts"], 0.347, atol=0.002)


def test_filters_and_smoothers_scatter_about_the_bound(found: thesis_ch3.Chapter3) -> None:
    for name in ("ekf-6", "ukf", "rts", "two-filter"):
        scatter = found.methods[name]
        error = scatter.std_arcsec / np.sqrt(found.runs)
        assert np.all(np.abs(scatter.rms_arcsec - found.bound_arcsec[name]) < 4.0 * error), name
        assert scatter.nees == pytest.approx(1.0, abs=0.12)


def test_the_complementary_filter_does_not_help(found: thesis_ch3.Chapter3) -> None:
    alone, paired = (np.mean(found.methods[name].rms_arcsec) for name in ("ukf", "cf-ukf"))
    assert paired > 0.999 * alone
    assert found.methods["cf-ukf"].nees > 1.2
    assert "does not help" in found.finding()


def test_json_holds_the_contract(found: thesis_ch3.Chapter3) -> None:
    result = plain(found.as_json())
    methods = {"ekf-6", "ukf", "cf-ukf", "rts", "two-filter"}
    assert set(result["rms_arcsec"]) == set(result["bound_arcsec"]) == methods
    assert all(len(value) == 3 for value in result["rms_arcsec"].values())
    assert {"3.2", "3.3", "3.4"} <= set(result["tables"])
    for parameter in result["gyro_parameters"].values():
        assert abs(parameter["mean"] - parameter["truth"]) < 3.0 * parameter["sigma"]


def test_refuses_a_single_run() -> None:
    with pytest.raises(ArgumentError, match="at least 2 runs"):
        thesis_ch3.run(1)
