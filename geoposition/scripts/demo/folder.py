"""The demo's folder: made whole, renewed only where a former demo stands, other files kept."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from geoposition.errors import MissingFileError, ProductError

MARK_FILE: Final = "demo.json"
MARK_KEY: Final = "geoposition_demo"


def check_folder(path: Path) -> None:
    """Refuse a folder that the demo must not write into, before any work is done."""
    if path.exists():
        if not path.is_dir():
            raise ProductError(path, "", "a folder for the demo expected, this is a file")
        if any(path.iterdir()) and _former_files(path) is None:
            raise ProductError(
                path,
                "",
                "a new folder, an empty one or a former demo's expected",
            )
        writable = path
    else:
        writable = path.parent
        if not writable.is_dir():
            raise MissingFileError(writable, "", "the folder to make the demo's in does not exist")
    if not os.access(writable, os.W_OK | os.X_OK):
        raise ProductError(writable, "", "a writable folder expected")


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Give a temporary folder; on success it becomes `path`, or its files replace the former ones.

    A new folder appears in one move. In an existing one the files of the former demo are
    replaced one by one, `demo.json` last, and everything else there stays.
    """
    check_folder(path)
    former = _former_files(path) if path.exists() else None
    beside = path if path.exists() else path.parent
    temporary = Path(tempfile.mkdtemp(prefix=".geoposition-demo.", dir=beside))
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o777 & ~umask)
        if path.exists():
            _replace(path, temporary, former or [])
        else:
            temporary.rename(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def files_of(folder: Path) -> list[str]:
    """Files below `folder`, as relative names with forward slashes, sorted."""
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def _replace(path: Path, new: Path, former: list[str]) -> None:
    names = files_of(new)
    for name in former:
        if name not in names:
            (path / name).unlink(missing_ok=True)
    for name in sorted(names, key=lambda n: n == MARK_FILE):
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (new / name).replace(path / name)


def _former_files(path: Path) -> list[str] | None:
    """Names of the files a former demo left in `path`; None if it is no demo's folder."""
    try:
        mark = json.loads((path / MARK_FILE).read_text(encoding="utf-8"))
        names = mark["files"] if MARK_KEY in mark else None
    except (OSError, ValueError, KeyError, TypeError):
        return None
    if not isinstance(names, list):
        return None
    # the list comes from a file: nothing outside the folder is ever touched
    return [n for n in names if isinstance(n, str) and n and _is_inside(n)]


def _is_inside(name: str) -> bool:
    parts = Path(name).parts
    return not Path(name).is_absolute() and ".." not in parts
