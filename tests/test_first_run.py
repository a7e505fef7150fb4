"""The first run says what it waits for, once, and to people only."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from geoposition.scripts.first_run import NOTICE, say_what_it_waits_for


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


def said(stream: io.StringIO, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(sys, "stderr", stream)
    say_what_it_waits_for(arguments)
    return stream.getvalue()


def test_said_until_something_is_compiled(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert said(Terminal(), ["demo"], monkeypatch) == NOTICE + "\n"
    (cache / "package").mkdir()
    (cache / "package" / "kernel.nbi").touch()
    assert said(Terminal(), ["demo"], monkeypatch) == ""


def test_not_said_to_scripts_nor_with_help(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert said(io.StringIO(), ["demo"], monkeypatch) == ""
    assert said(Terminal(), ["demo", "--help"], monkeypatch) == ""
