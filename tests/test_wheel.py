"""The wheel, alone in a clean environment: console command, type marker, no stray packages."""

from __future__ import annotations

import email
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

import geoposition

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--outdir", str(out), str(ROOT)],
        check=True,
        capture_output=True,
    )
    return next(out.glob("*.whl"))


def test_wheel_holds_one_package(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    top = {name.partition("/")[0] for name in names}
    assert {name for name in top if not name.endswith(".dist-info")} == {"geoposition"}
    assert "geoposition/py.typed" in names
    assert any(name.startswith("geoposition/scripts/templates/") for name in names)
    assert not [name for name in names if "__pycache__" in name or name.endswith(".nbi")]


def test_wheel_says_where_it_runs(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        name = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        facts = email.message_from_bytes(archive.read(name))
    assert facts["Version"] == geoposition.__version__
    assert facts["Requires-Python"] == ">=3.11"
    classifiers = facts.get_all("Classifier", [])
    versions = {c.rpartition(" ")[2] for c in classifiers if c.startswith("Programming Language")}
    assert versions == {"3", "3.11", "3.12", "3.13"}
    assert "Typing :: Typed" in classifiers
    assert not [word for word in facts.get_all("Requires-Dist", []) if "@" in word]


def test_console_command_in_a_clean_environment(wheel: Path, tmp_path: Path) -> None:
    """Only the wheel is new; its dependencies are seen through a path file, not copied."""
    venv.create(tmp_path / "env", with_pip=True)
    python = tmp_path / "env" / "bin" / "python"
    if not python.exists():
        python = tmp_path / "env" / "Scripts" / "python.exe"
    subprocess.run(
        [str(python), "-m", "pip", "install", "--no-deps", "--no-index", str(wheel)],
        check=True,
        capture_output=True,
    )
    purelib = subprocess.run(
        [str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()
    import numpy

    (Path(purelib) / "dependencies.pth").write_text(str(Path(numpy.__file__).parents[1]) + "\n")
    command = python.parent / "geoposition"
    done = subprocess.run(
        [str(command), "--version"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    where = subprocess.run(
        [str(python), "-c", "import geoposition.scripts.cli as c; print(c.__file__)"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    assert str(tmp_path) in where
    done = subprocess.run(
        [str(command), "info", "missing.xml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "missing.xml" in done.stderr
