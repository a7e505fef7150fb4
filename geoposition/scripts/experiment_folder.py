"""The folder of an experiment's files: made beside its place, and put there when all is done."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from geoposition.errors import ArgumentError
from geoposition.scripts.scratch import publish_folder, require_folder, scratch_beside

_TEXTS: Final = ("*.json", "*.html")


@contextmanager
def experiment_folder(output: Path | None, mark: str) -> Iterator[Path]:
    """Give a folder to fill that becomes `output`, or a fleeting one.

    The file `mark` is put there last: a folder with it holds a run that came to its end. An
    existing folder must be empty or a former run's.
    """
    if output is None:
        with TemporaryDirectory(prefix="geoposition-") as name:
            yield Path(name)
        return
    require_folder(output)
    if output.is_dir() and any(output.iterdir()) and not (output / mark).is_file():
        raise ArgumentError(f"{output}: a new folder, an empty one or a former run's expected")
    with scratch_beside(output) as folder:
        yield folder
        _renamed(folder, output)
        publish_folder(folder, output, last=mark)


def _renamed(folder: Path, output: Path) -> None:
    """Let files that name others in `folder` name them in `output`."""
    for path in (path for pattern in _TEXTS for path in folder.rglob(pattern)):
        text = path.read_text(encoding="utf-8")
        if str(folder) in text:
            path.write_text(text.replace(str(folder), str(output)), encoding="utf-8")
