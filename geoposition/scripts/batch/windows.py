"""A large scene in windows of rows: a job for each, and one that joins them when all are done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from geoposition.scripts.batch.jobs import Job

SPLIT: Final = frozenset({"reimage", "ortho"})
"""Commands that make a window of their image's rows (`--window`), and join such (`--windows`)."""
MOST_WINDOWS: Final = 1000


def window_names(scene: str, count: int) -> list[str]:
    """Names of the windows' jobs."""
    return [f"{scene}.{number}of{count}" for number in range(1, count + 1)]


def joined(whole: Job, parts: Sequence[Job]) -> Job:
    """Let `whole` take from `parts`, which are jobs like it, the rows of what can be split.

    Of its commands a part keeps those that are split, and none of their outputs but the rows.
    """
    windows = tuple(
        replace(part, commands=tuple(
            (name, (*arguments, "--window", f"{number}/{len(parts)}",
                    "--windows", _rows_folder(part, name)))
            for name, arguments in part.commands if arguments[0] in SPLIT
        ))
        for number, part in enumerate(parts, 1)
    )  # fmt: skip
    commands = tuple(
        (name, (*arguments, *(_taken(name, windows) if arguments[0] in SPLIT else ())))
        for name, arguments in whole.commands
    )
    return replace(whole, commands=commands, after=windows)


def _taken(step: str, windows: Sequence[Job]) -> list[str]:
    return [word for part in windows for word in ("--windows", _rows_folder(part, step))]


def _rows_folder(part: Job, step: str) -> str:
    return f"{part.folder}/{step}.rows"
