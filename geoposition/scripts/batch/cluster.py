# mypy: disable-error-code="no-untyped-call"
"""Scenes on a Dask cluster: only door to `dask.distributed`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError

from geoposition.errors import ArgumentError, GeopositionError
from geoposition.scripts.batch.jobs import Job, Outcome, Queue
from geoposition.scripts.batch.scene import run_scene

_CONNECT_S = 20.0


def run_on_cluster(
    jobs: Sequence[Job], scheduler: str, retries: int
) -> Iterator[tuple[Outcome, bool]]:
    """Run `jobs` on the workers of `scheduler`; yields as `run_locally` does.

    Workers need this package, the plan's paths, and one thread each: commands change the
    working folder, which a process has but one of. Dask moves the scenes of a dead worker.
    """
    try:
        from distributed import Client, as_completed
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise ArgumentError(
            "--scheduler: dask.distributed is missing; pip install 'geoposition[cluster]'"
        ) from None
    try:
        client = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ArgumentError(f"--scheduler: no Dask scheduler at {scheduler} ({error})") from None
    with client:
        _require_single_threads(client.scheduler_info(n_workers=-1))
        queue = Queue(jobs, retries)
        running = as_completed(loop=client.loop)
        jobs_of = {}

        def submit() -> None:
            while (job := queue.take()) is not None:
                future = client.submit(run_scene, job, pure=False)
                jobs_of[future] = job
                running.add(future)

        submit()
        for future in running:
            job = jobs_of.pop(future)
            try:
                outcome: Outcome = future.result()
            except KilledWorker:
                outcome = Outcome(job.id, "lost", "the workers that took it ended")
            except CancelledError:
                raise GeopositionError(
                    f"--scheduler: the scheduler at {scheduler} is gone; run the same command "
                    "again, and what is done is kept"
                ) from None
            yield from queue.tell(job, outcome)
            submit()


def _require_single_threads(info: dict[str, dict[str, dict[str, int]]]) -> None:
    workers = info["workers"]
    if any(worker["nthreads"] > 1 for worker in workers.values()):
        raise ArgumentError(
            "--scheduler: workers with one thread each expected (dask worker --nthreads 1)"
        )
