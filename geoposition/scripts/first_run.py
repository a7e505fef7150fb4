"""What the first run on a machine waits for: kernels are compiled once, then kept.

Numba keeps them beside the modules; where these are not the user's to write, in a folder of the
user's; where there is none, they last for the run.
"""

from __future__ import annotations

import atexit
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import geoposition

NOTICE: Final = (
    "geoposition: the first run compiles its kernels for this machine, one to two minutes in "
    "all; later runs start at once"
)
NOT_KEPT: Final = (
    "geoposition: no writable folder for compiled kernels, so that this run compiles them for "
    "itself alone; name one with the environment variable NUMBA_CACHE_DIR"
)
_FOLDER: Final = "NUMBA_CACHE_DIR"


def prepare(arguments: list[str]) -> None:
    """See that kernels have a place, before numba is there, and say what is to be waited for."""
    if {"-h", "--help", "--example", "--version"} & set(arguments):
        return
    folder = _kernel_folder()
    if folder is None:
        print(NOT_KEPT, file=sys.stderr)
        rest = TemporaryDirectory(prefix="geoposition-kernels-")
        atexit.register(rest.cleanup)
        os.environ[_FOLDER] = rest.name
    elif sys.stderr.isatty() and next(folder.rglob("*.nbi"), None) is None:
        print(NOTICE, file=sys.stderr)


def _kernel_folder() -> Path | None:
    """Folder under which compiled kernels are kept; the user's own is made known to numba."""
    named = os.environ.get(_FOLDER)
    package = Path(geoposition.__file__).parent
    if named or os.access(package, os.W_OK):
        return Path(named or package)
    folder = _user_cache() / "geoposition"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    if not os.access(folder, os.W_OK | os.X_OK):
        return None
    os.environ[_FOLDER] = str(folder)
    return folder


def _user_cache() -> Path:
    """Folder for what programs can make again."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
