"""Files that other files name: a name that no system can take names nothing."""

from __future__ import annotations

from pathlib import Path


def is_there(path: Path) -> bool:
    """Whether there is such a file; `Path.is_file` raises where a name is too long."""
    try:
        return path.is_file()
    except OSError:
        return False
