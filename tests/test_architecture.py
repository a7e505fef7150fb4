"""The house holds: import rules, one door to each outside library, style, types."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "geoposition"
DOORS = {
    "pyproj": ("datum.py",),
    "erfa": ("frames.py", "leap_seconds.py"),
    "astropy_iers_data": ("earth_orientation.py",),
    "cv2": ("matching/", "dense/sgm.py", "dense/filters.py"),
    "laspy": ("surface/point_cloud.py",),
    "atheris": ("scripts/fuzz/guided.py",),
    "gtsam": (
        "adjust/factors.py",
        "sensors/attitude_determination/graph/engine.py",
    ),
}
"""Where a library may be imported, below the package; benchmarks and peers are free."""


def imports_of(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.partition(".")[0])
    return names


@pytest.mark.parametrize("library", DOORS)
def test_one_door_to_each_library(library: str) -> None:
    users = [
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if library in imports_of(path)
    ]
    doors = (*DOORS[library], "scripts/bench/")
    assert [user for user in users if not user.startswith(doors)] == []


def test_no_print_and_no_exit_in_the_library() -> None:
    for path in PACKAGE.rglob("*.py"):
        if "scripts" in path.parts:
            continue
        calls = {
            node.func.id
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        }
        assert not calls & {"print", "exit", "input"}, path


def run_tool(*arguments: str) -> None:
    program = shutil.which(arguments[0], path=str(Path(sys.executable).parent))
    assert program is not None, f"{arguments[0]} is not installed: pip install '.[test]'"
    done = subprocess.run(
        [program, *arguments[1:]], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]


def test_import_rules() -> None:
    run_tool("lint-imports")


def test_style() -> None:
    run_tool("ruff", "check", ".")


def test_format() -> None:
    run_tool("ruff", "format", "--check", ".")


def test_types() -> None:
    run_tool("mypy")
