"""Files made in a hidden folder beside their place: they appear there whole, together, or not.

A run that is killed leaves such a folder behind; the next one for the same place clears it away.
A lock tells the folder of a dead run from that of one still at work.
"""

from __future__ import annotations

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


@contextmanager
def scratch_beside(target: Path) -> Iterator[Path]:
    """Give an empty folder on the same disk as `target`, and remove it in the end.

    Raises
    ------
    ProductError
        The place is not writable.
    """
    prefix = f".{target.name}-"
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _clear_dead(target.parent, prefix)
        folder = Path(mkdtemp(prefix=prefix, suffix=".part", dir=target.parent))
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

    An earlier run's `last` goes first, so that it never stands for a mixture.
    """
    try:
        target.mkdir(exist_ok=True)
        (target / last).unlink(missing_ok=True)
        names = [path.name for path in sorted(scratch.iterdir()) if path.name not in (_LOCK, last)]
        for name in (*names, last):
            (scratch / name).replace(target / name)
    except OSError as error:
        raise ProductError(target, "", f"a writable folder expected ({error.strerror})") from None


def _clear_dead(parent: Path, prefix: str) -> None:
    for folder in parent.glob(f"{escape(prefix)}*.part"):
        try:
            with (folder / _LOCK).open("wb") as lock:
                if not try_lock(lock):
                    continue
        except OSError:
            continue
        shutil.rmtree(folder, ignore_errors=True)
