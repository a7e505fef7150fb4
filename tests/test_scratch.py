"""Outputs appear whole: after a kill nothing stands in their place, and the rest is cleared."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from geoposition.errors import ProductError
from geoposition.scripts.scratch import publish_folder, scratch_beside

WORK = """
import sys, time
from pathlib import Path
from geoposition.scripts.scratch import scratch_beside
with scratch_beside(Path(sys.argv[1])) as folder:
    (folder / "half.tif").write_bytes(b"half of it")
    print("writing", flush=True)
    time.sleep(60)
"""


def started(target: Path) -> subprocess.Popen[str]:
    work = subprocess.Popen(
        [sys.executable, "-c", WORK, str(target)], stdout=subprocess.PIPE, text=True
    )
    assert work.stdout is not None
    assert work.stdout.readline() == "writing\n"
    return work


def test_a_killed_run_leaves_nothing_in_place_and_the_next_clears_up(tmp_path: Path) -> None:
    target = tmp_path / "steady[1]"
    work = started(target)
    try:
        (scratch,) = tmp_path.iterdir()
        # one that is still at work is left alone
        with scratch_beside(target):
            assert (scratch / "half.tif").is_file()
    finally:
        work.kill()
        work.communicate()
    assert not target.exists()
    assert scratch.is_dir()
    with scratch_beside(target) as mine:
        assert not scratch.exists()
        (mine / "image.tif").write_bytes(b"all of it")
        (mine / "done.json").write_bytes(b"{}")
        publish_folder(mine, target, "done.json")
    assert {path.name for path in tmp_path.iterdir()} == {"steady[1]"}
    assert {path.name for path in target.iterdir()} == {"image.tif", "done.json"}


def test_a_folder_replaces_that_of_an_earlier_run(tmp_path: Path) -> None:
    target = tmp_path / "out"
    for name in ("first", "second"):
        with scratch_beside(target) as mine:
            (mine / "chain").mkdir()
            (mine / "chain" / name).touch()
            (mine / "done.json").touch()
            publish_folder(mine, target, "done.json")
    assert [path.name for path in (target / "chain").iterdir()] == ["second"]


def test_an_error_leaves_nothing(tmp_path: Path) -> None:
    def broken_off() -> None:
        with scratch_beside(tmp_path / "out") as folder:
            (folder / "half.tif").write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken_off()
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ProductError, match="writable place"), scratch_beside(tmp_path / "file/out"):
        pass


def test_root_of_a_disk_is_filled_from_within(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Renaming works on one disk only, and what is beside a mounted folder is another disk."""
    target = tmp_path / "out"
    target.mkdir()
    monkeypatch.setattr(Path, "is_mount", lambda self: self == target)
    with scratch_beside(target) as folder:
        assert folder.parent == target
        (folder / "last.json").write_text("{}")
        publish_folder(folder, target, "last.json")
    assert [path.name for path in target.iterdir()] == ["last.json"]


def test_the_working_folder_has_its_scratch_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    with scratch_beside(Path()) as folder:
        assert folder.parent == tmp_path
