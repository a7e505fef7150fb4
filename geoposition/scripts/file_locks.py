"""Locks on open files: the system frees them when the process ends, however it does.

Where there are none (Windows), an open file cannot be removed, and that is lock enough.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import IO, Any, Final

_FCNTL: Final[Any] = import_module("fcntl") if find_spec("fcntl") else None


def wait_for_lock(file: IO[Any]) -> None:
    """Take the lock of the open `file`, as soon as nobody has it."""
    if _FCNTL is not None:
        _FCNTL.flock(file, _FCNTL.LOCK_EX)


def try_lock(file: IO[Any]) -> bool:
    """Take the lock of the open `file` if nobody has it, and tell."""
    if _FCNTL is None:
        return True
    try:
        _FCNTL.flock(file, _FCNTL.LOCK_EX | _FCNTL.LOCK_NB)
    except OSError:
        return False
    return True
