"""Rows of a large image made apart, by several workers: windows of rows in files, and back.

A window is a folder: for each strip of rows one file per array, and `window.json`, written last,
which says what they are rows of. Windows of another run are refused.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from geoposition.errors import ArgumentError, ProductError
from geoposition.scripts.results import plain
from geoposition.scripts.scratch import publish_folder, scratch_beside

Arrays = Mapping[str, NDArray[Any]]
Put = Callable[[int, Arrays], None]

_MARK: Final = "window.json"
_WINDOW: Final = re.compile(r"(\d{1,6})/(\d{1,6})")


@dataclass(frozen=True, slots=True)
class Window:
    """The `number`th of `count` windows of rows, from 1."""

    number: int
    count: int

    @classmethod
    def of(cls, words: str) -> Window:
        """Read `2/5`."""
        match = _WINDOW.fullmatch(words)
        window = cls(int(match[1]), int(match[2])) if match else cls(0, 0)
        if not 1 <= window.number <= window.count:
            raise ArgumentError(f"--window: K/N expected, as 2/5, got {words!r}")
        return window

    def rows(self, total: int, block: int) -> tuple[int, int]:
        """First row and the one after the last, of `total`: whole blocks of `block` rows.

        With more windows than blocks some have no rows.
        """
        blocks = -(-total // block)
        first, end = ((self.number - 1 + k) * blocks // self.count * block for k in (0, 1))
        return min(first, total), min(end, total)


@dataclass(frozen=True, slots=True)
class Split:
    """How a run is split: it makes `window` alone, into `folders[0]`, or joins those there are."""

    window: Window | None = None
    folders: tuple[Path, ...] = ()

    @classmethod
    def of(cls, window: str | None, folders: Sequence[Path]) -> Split:
        """Take what the command line says."""
        if window is None:
            return cls(None, tuple(folders))
        if len(folders) != 1:
            raise ArgumentError("--window: one folder for its rows expected (--windows FOLDER)")
        return cls(Window.of(window), tuple(folders))


def settings_of(
    files: Sequence[Path | None], shape: Sequence[int], facts: Mapping[str, object]
) -> dict[str, object]:
    """Say what a window is of: files as they are, the image's shape, what is asked for."""
    known = [
        [str(path), (facts_ := path.stat()).st_size, facts_.st_mtime_ns]
        for path in files
        if path is not None and path.exists()
    ]
    found: dict[str, object] = plain({"files": known, "shape": list(shape), "asked": dict(facts)})
    return found


@contextmanager
def written_window(
    folder: Path, settings: Mapping[str, object], rows: tuple[int, int]
) -> Iterator[Put]:
    """Give what takes a strip, its first row and arrays; the window is there when all is."""
    if folder.exists() and any(folder.iterdir()) and not (folder / _MARK).exists():
        raise ProductError(folder, "", "a folder of a window expected, it holds other files")
    with scratch_beside(folder) as scratch:

        def put(first: int, arrays: Arrays) -> None:
            for name, values in arrays.items():
                np.save(_place(scratch, first, name), values, allow_pickle=False)

        yield put
        facts = {"rows": rows, "settings": settings}
        (scratch / _MARK).write_text(json.dumps(facts, indent=1), encoding="utf-8")
        publish_folder(scratch, folder, _MARK)


def windows_rows(
    folders: Sequence[Path], settings: Mapping[str, object], total: int, names: Sequence[str]
) -> Iterator[tuple[int, dict[str, NDArray[Any]]]]:
    """Give all strips, first row and arrays, of the windows in `folders`, in order.

    Raises
    ------
    ProductError
        A window is missing, or is one of another run.
    """
    windows = sorted((_rows_of(folder, settings), folder) for folder in folders)
    at = 0
    for (first, end), folder in windows:
        if first != at:
            raise ProductError(folder, "rows", f"the window from row {at} on expected, got {first}")
        while at < end:
            arrays = {name: _loaded(_place(folder, at, name)) for name in names}
            yield at, arrays
            at += arrays[names[0]].shape[-2]
    if at != total:
        raise ProductError(windows[-1][1], "rows", f"windows of {total} rows expected, got {at}")


def _rows_of(folder: Path, settings: Mapping[str, object]) -> tuple[int, int]:
    path = folder / _MARK
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        own, (first, end) = facts["settings"], facts["rows"]
    except FileNotFoundError:
        raise ProductError(path, "", "a window of the image expected, there is none") from None
    except (ValueError, KeyError, TypeError):
        raise ProductError(path, "", "the mark of a window expected") from None
    wrong = next((name for name in settings if own.get(name) != settings[name]), None)
    if wrong is not None:
        raise ProductError(path, wrong, "a window of the same run expected; make it again")
    return int(first), int(end)


def _place(folder: Path, first: int, name: str) -> Path:
    return folder / f"{first:07d}-{name}.npy"


def _loaded(path: Path) -> NDArray[Any]:
    try:
        values: NDArray[Any] = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        raise ProductError(path, "", "rows of a window expected, not readable") from None
    return values
