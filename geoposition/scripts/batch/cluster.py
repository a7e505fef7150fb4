# mypy: disable-error-code="no-untyped-call"
"""Scenes on a Dask cluster: only door to `dask.distributed`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from geoposition.errors import ArgumentError
from geoposition.scripts.batch.plan import Job
from geoposition.scripts.batch.scene import Outcome, run_scene

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
        tries = dict.fromkeys((job.id for job in jobs), 1)
        by_future = {client.submit(run_scene, job, pure=False): job for job in jobs}
        queue = as_completed(list(by_future), loop=client.loop)
        for future in queue:
            job = by_future.pop(future)
            try:
                outcome: Outcome = future.result()
            except KilledWorker:
                outcome = Outcome(job.id, "lost", "the workers that took it ended")
            again = outcome.status in ("failed", "lost") and tries[job.id] <= retries
            if again:
                tries[job.id] += 1
                future = client.submit(run_scene, job, pure=False)
                by_future[future] = job
                queue.add(future)
            yield outcome, not again


def _require_single_threads(info: dict[str, dict[str, dict[str, int]]]) -> None:
    workers = info["workers"]
    if any(worker["nthreads"] > 1 for worker in workers.values()):
        raise ArgumentError(
            "--scheduler: workers with one thread each expected (dask worker --nthreads 1)"
        )
