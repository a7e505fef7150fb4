"""What workers are told and what they answer; which job is next, and which has had its tries."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Status = Literal["done", "kept", "failed", "lost"]


@dataclass(frozen=True, slots=True)
class Job:
    """One scene, or a window of a large one: what a worker needs to run it, and nothing else.

    `commands` are (name, arguments) with all placeholders filled in; `base` is the folder they
    run in; `folder` is where the files go. `after` are jobs that have to be done before: the
    scene's windows, which are not needed any more when it is done.
    """

    id: str
    base: str
    folder: str
    commands: tuple[tuple[str, tuple[str, ...]], ...]
    after: tuple[Job, ...] = ()

    def digest(self) -> str:
        """Fingerprint of the commands and of the files they name: their sizes and times."""
        found: list[object] = [self.base, self.commands]
        made = [self.folder, *(job.folder for job in self.after)]
        for argument in sorted({a for _, arguments in self.commands for a in arguments}):
            path = Path(self.base) / argument
            if not any(map(path.is_relative_to, made)) and path.exists():
                facts = path.stat()
                found.append((argument, facts.st_size, facts.st_mtime_ns))
        return hashlib.sha256(json.dumps(found).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one try: `kept` was done before; `lost` took its worker with it."""

    id: str
    status: Status
    message: str = ""
    seconds: float = 0.0

    @property
    def good(self) -> bool:
        """Whether the job is done."""
        return self.status in ("done", "kept")


class Queue:
    """Jobs in order, each when those before it are done, again when it failed and may be tried."""

    def __init__(self, jobs: Sequence[Job], retries: int) -> None:
        self._waiting = list(jobs)
        self._most = retries + 1
        self._tries = dict.fromkeys((job.id for job in jobs), 0)
        self._open = {job.id for job in jobs}

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def take(self) -> Job | None:
        """Return the next job that can be run now, if there is one."""
        for place, job in enumerate(self._waiting):
            if not any(part.id in self._open for part in job.after):
                self._tries[job.id] += 1
                return self._waiting.pop(place)
        return None

    def tell(self, job: Job, outcome: Outcome) -> Iterator[tuple[Outcome, bool]]:
        """Take in the outcome of a try; gives what follows from it, and whether it is the last."""
        again = not outcome.good and self._tries[job.id] < self._most
        if again:
            self._waiting.append(job)
        else:
            self._open.discard(job.id)
        yield outcome, not again
        if outcome.good or again:
            return
        for other in [other for other in self._waiting if job in other.after]:
            self._waiting.remove(other)
            self._open.discard(other.id)
            yield Outcome(other.id, "failed", f"{job.id}: {outcome.message}"), True
