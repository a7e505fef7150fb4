"""Local processes that run scenes: each dies alone, and another takes its place."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from geoposition.scripts.batch.jobs import Job, Outcome, Queue
from geoposition.scripts.batch.scene import run_scene
from geoposition.scripts.processes import threads_each


@dataclass(slots=True)
class _Worker:
    process: BaseProcess
    pipe: Connection
    job: Job | None = None


def run_locally(
    jobs: Sequence[Job], workers: int, retries: int, threads: int
) -> Iterator[tuple[Outcome, bool]]:
    """Run `jobs` in `workers` processes of `threads` threads each.

    Yields every try's outcome and whether it is the scene's last. A worker that dies (killed,
    out of memory) costs its own scene one try.
    """
    queue = Queue(jobs, retries)
    context = multiprocessing.get_context("spawn")
    with threads_each(threads):
        pool = [_started(context) for _ in range(min(workers, len(jobs)))]
        try:
            while queue or any(worker.job for worker in pool):
                for worker in pool:
                    if worker.job is None:
                        worker.job = queue.take()
                        if worker.job is not None:
                            with suppress(OSError):  # it died idle: seen below as lost
                                worker.pipe.send(worker.job)
                busy = [worker for worker in pool if worker.job]
                ready = wait([worker.pipe for worker in busy])
                for place, worker in enumerate(pool):
                    if worker.job is None or worker.pipe not in ready:
                        continue
                    job, worker.job = worker.job, None
                    outcome = _received(worker, job)
                    if outcome.status == "lost":
                        pool[place] = _started(context)
                    yield from queue.tell(job, outcome)
        finally:
            for worker in pool:
                worker.pipe.close()
                if worker.job is not None:
                    worker.process.terminate()
            for worker in pool:
                worker.process.join()


def _received(worker: _Worker, job: Job) -> Outcome:
    try:
        outcome: Outcome = worker.pipe.recv()
    except (EOFError, OSError):
        worker.process.join()
        worker.pipe.close()
        return Outcome(job.id, "lost", f"its worker ended with status {worker.process.exitcode}")
    return outcome


def _started(context: multiprocessing.context.SpawnContext) -> _Worker:
    mine, other = context.Pipe()
    process = context.Process(target=_work, args=(other,), daemon=True)
    process.start()
    other.close()
    return _Worker(process, mine)


def _work(pipe: Connection) -> None:
    """Run what comes, until the driver closes the pipe or is gone."""
    with suppress(EOFError, OSError, KeyboardInterrupt):
        while True:
            pipe.send(run_scene(pipe.recv()))
