"""The suite of asv runs: every case at a tiny size, its memory, the start of the program."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from geoposition.scripts.bench.history import HISTORY, TINY

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def suite() -> ModuleType:
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("benchmarks/ is not beside the tests: not a checkout")
    sys.path.insert(0, str(ROOT))
    try:
        return importlib.import_module("benchmarks.history")
    finally:
        sys.path.remove(str(ROOT))


@pytest.mark.parametrize("key", HISTORY)
def test_a_case_runs_and_tells_its_memory(suite: ModuleType, key: str) -> None:
    class Tiny(suite.Work):  # type: ignore[name-defined, misc]
        sizes = TINY

    work = Tiny()
    work.setup(key)
    folder = Path(work._folder.name)
    try:
        work.time_call(key)
        assert not work.track_peak_memory(key) < 0.0
    finally:
        work.teardown(key)
    assert not folder.exists()


def test_the_start_is_python_that_runs(suite: ModuleType) -> None:
    start = suite.Start()
    for code in (start.timeraw_import(), start.timeraw_help()):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert done.stdout == ""  # asv reads its own figures there


def test_asv_finds_the_suite_of_this_checkout() -> None:
    path = ROOT / "asv.conf.json"
    if not path.is_file():
        pytest.skip("asv.conf.json is not beside the tests: not a checkout")
    conf = json.loads(path.read_text(encoding="utf-8"))
    assert (ROOT / conf["benchmark_dir"] / "history.py").is_file()
    assert conf["repo"] == "."
