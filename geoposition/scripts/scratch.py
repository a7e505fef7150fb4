"""Files made in a hidden folder near their place: they appear there whole, together, or not.

A run that is killed leaves such a folder behind; the next one for the same place clears it away.
A lock tells the folder of a dead run from that of one still at work.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from glob import escape
from pathlib import Path
from tempfile import mkdtemp
from typing import Final

from geoposition.errors import ProductError
from geoposition.scripts.file_locks import try_lock

_LOCK: Final = ".lock"


def require_folder(target: Path) -> None:
    """Refuse a file where a folder is to be filled."""
    if target.exists() and not target.is_dir():
        raise ProductError(target, "", "a folder for the results expected, this is a file")


@contextmanager
def scratch_beside(target: Path) -> Iterator[Path]:
    """Give an empty folder on the same disk as `target`, and remove it in the end.

    It lies beside `target`; within it where `target` is the root of a disk, or beside it nothing
    may be written.

    Raises
    ------
    ProductError
        The place is not writable.
    """
    target = target.resolve()
    prefix = f".{target.name}-"
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        place = target if _only_within(target) else target.parent
        _clear_dead(place, prefix)
        folder = Path(mkdtemp(prefix=prefix, suffix=".part", dir=place))
        lock = (folder / _LOCK).open("wb")
    except OSError as error:
        raise ProductError(target, "", f"a writable place expected ({error.strerror})") from None
    try:
        try_lock(lock)
        yield folder
    finally:
        lock.close()
        shutil.rmtree(folder, ignore_errors=True)


def publish_folder(scratch: Path, target: Path, last: str) -> None:
    """Move what is in `scratch` into the folder `target`; the file `last` is there when all is.

    An earlier run's `last` goes first, so that it never stands for a mixture. A folder takes the
    place of one of its name with all that is in it: the caller knows it for an earlier run's.
    """
    try:
        target.mkdir(exist_ok=True)
        (target / last).unlink(missing_ok=True)
        names = [name for name in made_in(scratch) if name != last]
        for name in (*names, last):
            if (scratch / name).is_dir() and (target / name).is_dir():
                shutil.rmtree(target / name)
            (scratch / name).replace(target / name)
    except OSError as error:
        raise ProductError(target, "", f"a writable folder expected ({error.strerror})") from None


def made_in(scratch: Path) -> list[str]:
    """Names of what was put into a scratch folder, in order."""
    return [path.name for path in sorted(scratch.iterdir()) if path.name != _LOCK]


def _only_within(target: Path) -> bool:
    return target.is_dir() and (target.is_mount() or not os.access(target.parent, os.W_OK))


def _clear_dead(parent: Path, prefix: str) -> None:
    for folder in parent.glob(f"{escape(prefix)}*.part"):
        try:
            with (folder / _LOCK).open("wb") as lock:
                if not try_lock(lock):
                    continue
        except OSError:
            continue
        shutil.rmtree(folder, ignore_errors=True)
