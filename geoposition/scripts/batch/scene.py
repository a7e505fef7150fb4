"""One scene of a batch, in a worker: its commands, its log, and the mark that it is done.

A scene's folder is begun anew, holds the mark `scene.json` as the last file written, and only
then counts. A lock keeps two workers from one scene, also when one of them has lost its driver.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Final

from geoposition.errors import ProductError
from geoposition.scripts.batch.jobs import Job, Outcome, Status
from geoposition.scripts.file_locks import wait_for_lock
from geoposition.scripts.tables import whole_file

MARK: Final = "scene.json"
STATE: Final = ".batch"
"""Folder beside the scenes for locks and the journal."""
_BEGUN: Final = ".begun"
_LAST_LINE: Final = 500


def run_scene(job: Job) -> Outcome:
    """Run a scene's commands unless it is done; what fails is said, never raised."""
    begin = time.perf_counter()
    folder = Path(job.folder)
    state = folder.parent / STATE
    try:
        state.mkdir(parents=True, exist_ok=True)
        with _locked(state / f"{job.id}.lock"):
            digest = job.digest()
            if is_done(folder, digest):
                _drop_windows(job)
                return Outcome(job.id, "kept")
            _journal(state, job.id, "begun")
            _fresh(folder)
            message = _commands(job, folder)
            if not message:
                _mark(folder, job, digest)
                (folder / _BEGUN).unlink()
                _drop_windows(job)
            seconds = time.perf_counter() - begin
            status: Status = "failed" if message else "done"
            _journal(state, job.id, status)
            return Outcome(job.id, status, message, round(seconds, 3))
    except (OSError, ProductError) as error:
        return Outcome(job.id, "failed", f"{job.id}: {error}")


def _drop_windows(job: Job) -> None:
    """Remove the windows of a scene that is done: as many bytes as the image has."""
    for part in job.after:
        shutil.rmtree(part.folder, ignore_errors=True)


def is_done(folder: Path, digest: str) -> bool:
    """Whether the scene in `folder` is complete and came of the same commands and files."""
    try:
        return bool(json.loads((folder / MARK).read_text(encoding="utf-8"))["digest"] == digest)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _fresh(folder: Path) -> None:
    """Begin with an empty folder; one that is no scene's is left alone."""
    if folder.exists() and any(folder.iterdir()):
        if not (folder / _BEGUN).exists() and not (folder / MARK).exists():
            raise ProductError(folder, "", "a folder of this batch expected, it holds other files")
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _BEGUN).touch()


def _commands(job: Job, folder: Path) -> str:
    """Run the commands one after the other; returns the first failure's line, or nothing."""
    from geoposition.scripts.cli import run

    before = Path.cwd()
    try:
        os.chdir(job.base)
        for name, arguments in job.commands:
            result, log = folder / f"{name}.json", folder / f"{name}.log"
            with (
                whole_file(result) as part,
                part.open("w", encoding="utf-8") as out,
                log.open("w", encoding="utf-8") as err,
                redirect_stdout(out),
                redirect_stderr(err),
            ):
                status = run([*arguments, *([] if "--json" in arguments else ["--json"])])
            if status != 0:
                result.unlink()
                lines = log.read_text(encoding="utf-8").strip().splitlines() or [f"exit {status}"]
                return f"{name}: {lines[-1][:_LAST_LINE].removeprefix('geoposition: ')}"
    finally:
        os.chdir(before)
    return ""


def _mark(folder: Path, job: Job, digest: str) -> None:
    """Write what the scene is made of; from now on it is done."""
    files = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != _BEGUN:
            with path.open("rb") as stream:
                sum_ = hashlib.file_digest(stream, "sha256").hexdigest()
            name = path.relative_to(folder).as_posix()
            files[name] = {"bytes": path.stat().st_size, "sha256": sum_}
    facts = {
        "id": job.id,
        "digest": digest,
        "commands": {name: list(arguments) for name, arguments in job.commands},
        "files": files,
    }
    with whole_file(folder / MARK) as part:
        part.write_text(json.dumps(facts, indent=1), encoding="utf-8")


def _journal(state: Path, scene: str, event: str) -> None:
    """Add a line; short appends are not torn, also from several processes."""
    line = json.dumps({"time_s": round(time.time(), 3), "id": scene, "event": event})
    with (state / "journal.jsonl").open("a", encoding="utf-8") as out:
        out.write(line + "\n")


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("w") as file:
        wait_for_lock(file)
        yield
