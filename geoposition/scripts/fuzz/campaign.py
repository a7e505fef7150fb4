"""A campaign: so many mutated inputs to every target, in processes that may die or hang."""

from __future__ import annotations

import io
import multiprocessing
import random
import shutil
import signal
import time
import traceback
import warnings
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from math import ceil
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Final

from geoposition.errors import GeopositionError
from geoposition.scripts.fuzz.mutations import mutate
from geoposition.scripts.fuzz.targets import Seed, Target, targets
from geoposition.scripts.results import Progress

HANG_S: Final = 10.0
"""An input that takes more of the processor's time is a finding."""
_STUCK_S: Final = 300.0
"""One that waits so long is, too."""
_PART: Final = 2_000
_KEPT: Final = 5
_TRIED: Final = 20
_ONE_LINE: Final = 2_000


@dataclass(frozen=True, slots=True)
class Part:
    """Inputs `begin` to `begin + count` of a target; the same ones whenever it is run."""

    target: str
    begin: int
    count: int
    seed: int

    def folder(self, keep: Path) -> Path:
        """Where the input is that is being read."""
        return keep / f".running-{zlib.crc32(self.target.encode()):08x}-{self.begin}"


@dataclass(slots=True)
class Tally:
    """What became of a target's inputs: read, refused, and findings (kind, message, files)."""

    target: str
    read: int = 0
    refused: int = 0
    seconds: float = 0.0
    findings: list[tuple[str, str, dict[str, bytes]]] = field(default_factory=list)

    @property
    def inputs(self) -> int:
        """How many inputs there were."""
        return self.read + self.refused + len(self.findings)

    def add(self, other: Tally) -> None:
        """Take in another part of the same target's."""
        self.read += other.read
        self.refused += other.refused
        self.seconds += other.seconds
        self.findings += other.findings


def run(
    data: Path | None,
    inputs: int,
    processes: int,
    seed: int,
    only: str,
    keep: Path,
    progress: Progress,
) -> list[Tally]:
    """Feed `inputs` in all to the targets whose name holds `only`, fast ones getting more.

    Findings go to `keep`, a folder each. A process that dies is a finding, and its last input
    is kept.
    """
    keep.mkdir(parents=True, exist_ok=True)
    counts = _shares([target for target in targets(data) if only in target.name], inputs, keep)
    total = sum(counts.values())
    parts = [
        Part(name, begin, min(_PART, count - begin), seed)
        for name, count in counts.items()
        for begin in range(0, count, _PART)
    ]
    random.Random(seed).shuffle(parts)
    tallies = {name: Tally(name) for name in counts}
    done = 0
    broken: list[Part] = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context) as pool:
        futures = {pool.submit(_run_part, data, part, keep): part for part in parts}
        for future in as_completed(futures):
            part = futures[future]
            try:
                tallies[part.target].add(future.result())
            except BrokenProcessPool:
                broken.append(part)
                continue
            done += part.count
            progress(done, total)
    # One of them killed its process, and with it the pool: one by one it shows which.
    for part in broken:
        with ProcessPoolExecutor(1, context) as pool:
            try:
                tallies[part.target].add(pool.submit(_run_part, data, part, keep).result())
            except BrokenProcessPool:
                tallies[part.target].findings.append(("crash", f"{part}", _last_input(keep, part)))
        done += part.count
        progress(done, total)
    for tally in tallies.values():
        save(keep, tally)
    return list(tallies.values())


def _shares(found: Sequence[Target], inputs: int, folder: Path) -> dict[str, int]:
    """Give each target inputs: the same time for all, yet none below a tenth of an even share."""
    rates = []
    for target in found:
        rng, tally = random.Random(target.name), Tally(target.name)
        begin = time.perf_counter()
        with TemporaryDirectory(dir=folder) as place:
            for _ in range(_TRIED):
                feed(target, rng, Path(place), tally)
        rates.append(_TRIED / max(time.perf_counter() - begin, 1e-3))
    even = inputs / max(len(found), 1)
    return {
        target.name: ceil(max(0.1 * even, inputs * rate / sum(rates)))
        for target, rate in zip(found, rates, strict=True)
    }


_CACHE: dict[str, Target] = {}


def _run_part(data: Path | None, part: Part, keep: Path) -> Tally:
    if not _CACHE:
        _CACHE.update((target.name, target) for target in targets(data))
    target, rng = _CACHE[part.target], random.Random(f"{part}")
    tally = Tally(part.target)
    begin = time.perf_counter()
    folder = part.folder(keep)
    folder.mkdir(parents=True, exist_ok=True)
    for _ in range(part.count):
        feed(target, rng, folder, tally)
    shutil.rmtree(folder)
    tally.seconds = time.perf_counter() - begin
    return tally


def _last_input(keep: Path, part: Part) -> dict[str, bytes]:
    folder = part.folder(keep)
    files = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    shutil.rmtree(folder)
    return files


def feed(target: Target, rng: random.Random, folder: Path, tally: Tally) -> None:
    """Mutate one of the target's seeds in `folder`, read it, and note what happened."""
    seed = rng.choice(target.seeds)
    files = dict(seed.files)
    name = seed.main if rng.random() < 0.7 else rng.choice(list(files))
    files[name] = mutate(files[name], rng)
    judge(target, Seed(seed.main, files), folder, tally)


def judge(target: Target, seed: Seed, folder: Path, tally: Tally) -> None:
    """Read one input: right, refused in one line, or a finding."""
    for name, content in seed.files.items():
        (folder / name).write_bytes(content)
    try:
        with _watched(), _quiet():
            target.read(folder / seed.main)
    except GeopositionError as error:
        message = str(error)
        if "\n" in message or len(message) > _ONE_LINE or not message.strip():
            tally.findings.append(("not one line", message[:200], seed.files))
        else:
            tally.refused += 1
    except _HangError:
        tally.findings.append(("hang", f"more than {HANG_S} s", seed.files))
    except Exception:
        tally.findings.append(("traceback", traceback.format_exc(limit=-4), seed.files))
    else:
        tally.read += 1


class _HangError(BaseException):
    """Not an Exception: no reader may swallow it."""


@contextmanager
def _quiet() -> Iterator[None]:
    with (
        redirect_stdout(io.StringIO()),
        redirect_stderr(io.StringIO()),
        warnings.catch_warnings(action="ignore"),
    ):
        yield


@contextmanager
def _watched() -> Iterator[None]:
    def stop(number: int, frame: FrameType | None) -> None:
        raise _HangError

    # Of its own time: on a loaded machine everything takes long by the clock.
    before = signal.signal(signal.SIGPROF, stop), signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_PROF, HANG_S)
    signal.setitimer(signal.ITIMER_REAL, _STUCK_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGPROF, before[0])
        signal.signal(signal.SIGALRM, before[1])


def save(keep: Path, tally: Tally) -> None:
    """Write each different finding's files, a few of a kind, and what was said of it."""
    seen: dict[str, int] = {}
    for kind, message, files in tally.findings:
        cause = f"{kind} {message.strip().splitlines()[-1][:80] if message.strip() else ''}"
        seen[cause] = seen.get(cause, 0) + 1
        if seen[cause] > _KEPT:
            continue
        safe = "".join(c if c.isalnum() else "_" for c in f"{tally.target}-{kind}")
        folder = keep / f"{safe}-{len(seen)}-{seen[cause]}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "finding.txt").write_text(f"{kind}\n{message}\n")
        for name, content in files.items():
            (folder / name).write_bytes(content)


def summary(tallies: Sequence[Tally]) -> dict[str, object]:
    """Return counts by target, fit for JSON."""
    return {
        "inputs": sum(tally.inputs for tally in tallies),
        "findings": sum(len(tally.findings) for tally in tallies),
        "targets": {
            tally.target: {
                "inputs": tally.inputs,
                "read": tally.read,
                "refused": tally.refused,
                "findings": len(tally.findings),
                "seconds": round(tally.seconds, 2),
            }
            for tally in tallies
        },
    }
