"""Shared fixtures: the place of the real data, and a loud, counted word when it is absent."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# A test's verdict must not depend on what else the machine does.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
    # Several processes share the cores: threads that wait for each other's cores cost far more.
    _share = (os.cpu_count() or 1) // int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
    os.environ.setdefault("NUMBA_NUM_THREADS", str(max(_share, 1)))

_REAL = Path(
    os.environ.get("GEOPOSITION_REAL_DATA", Path(__file__).resolve().parents[2] / "shared" / "real")
)


@pytest.fixture(scope="session")
def real_data_root() -> Path | None:
    return _REAL if _REAL.is_dir() else None


@pytest.fixture
def real_data(real_data_root: Path | None) -> Path:
    """Folder of the real data; the test is skipped, and counted, where it is absent."""
    if real_data_root is None:
        pytest.skip(f"REAL DATA ABSENT: {_REAL} (set GEOPOSITION_REAL_DATA)")
    return real_data_root


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    absent = [
        report
        for report in terminalreporter.stats.get("skipped", [])
        if "REAL DATA ABSENT" in str(report.longrepr)
    ]
    if absent:
        terminalreporter.write_sep("!", f"{len(absent)} tests did not run: real data absent")
