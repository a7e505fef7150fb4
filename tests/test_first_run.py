"""The first run says what it waits for, once, and to people only; kernels always have a place."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path

import pytest

import geoposition
from geoposition.scripts import first_run
from geoposition.scripts.first_run import NOT_KEPT, NOTICE, prepare


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


@pytest.fixture
def not_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package that belongs to somebody else, and a user's cache in the folder returned."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # so that it is restored
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    package = Path(geoposition.__file__).parent
    access = os.access
    monkeypatch.setattr(
        first_run.os, "access", lambda path, mode: path != package and access(path, mode)
    )
    monkeypatch.setattr(sys, "platform", "linux")
    return tmp_path / "cache"


def said(stream: io.StringIO, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(sys, "stderr", stream)
    prepare(arguments)
    return stream.getvalue()


def test_said_until_something_is_compiled(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert said(Terminal(), ["demo"], monkeypatch) == NOTICE + "\n"
    (cache / "package").mkdir()
    (cache / "package" / "kernel.nbi").touch()
    assert said(Terminal(), ["demo"], monkeypatch) == ""


def test_not_said_to_scripts_nor_with_help(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert said(io.StringIO(), ["demo"], monkeypatch) == ""
    assert said(Terminal(), ["demo", "--help"], monkeypatch) == ""


def test_a_package_of_others_keeps_kernels_with_the_user(
    not_ours: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert said(Terminal(), ["demo"], monkeypatch) == NOTICE + "\n"
    assert os.environ["NUMBA_CACHE_DIR"] == str(not_ours / "geoposition")
    assert (not_ours / "geoposition").is_dir()


def test_without_any_place_the_run_compiles_for_itself(
    not_ours: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    not_ours.write_text("a file where the folder should be")
    assert said(io.StringIO(), ["demo"], monkeypatch) == NOT_KEPT + "\n"
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    assert folder.is_dir()
    assert not_ours not in folder.parents
