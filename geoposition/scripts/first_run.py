"""What the first run on a machine waits for: kernels are compiled once, then kept."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import geoposition

NOTICE = (
    "geoposition: the first run compiles its kernels for this machine, one to two minutes in "
    "all; later runs start at once"
)


def say_what_it_waits_for(arguments: list[str]) -> None:
    """Print `NOTICE` on a terminal if nothing has been compiled yet and a command is to run."""
    if not sys.stderr.isatty() or {"-h", "--help", "--example", "--version"} & set(arguments):
        return
    if not _compiled():
        print(NOTICE, file=sys.stderr)


def _compiled() -> bool:
    """Whether compiled kernels lie where numba keeps them; yes where that cannot be told."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(named) if named else Path(geoposition.__file__).parent
    if not named and not os.access(folder, os.W_OK):
        return True  # numba then keeps them in the user's own folder
    return next(folder.rglob("*.nbi"), None) is not None
