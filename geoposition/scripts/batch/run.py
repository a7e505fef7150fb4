"""A batch from plan to manifest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from geoposition.scripts.batch.cluster import run_on_cluster
from geoposition.scripts.batch.jobs import Job
from geoposition.scripts.batch.local import run_locally
from geoposition.scripts.batch.manifest import NAME, Manifest
from geoposition.scripts.batch.plan import Plan
from geoposition.scripts.batch.scene import is_done
from geoposition.scripts.processes import cores
from geoposition.scripts.results import Progress


def run(
    plan: Plan, workers: int | None, threads: int | None, scheduler: str | None, progress: Progress
) -> Manifest:
    """Run what is not done yet; the manifest is on disk after every scene."""
    plan.output.mkdir(parents=True, exist_ok=True)
    jobs = list(_wanted(plan.jobs))
    manifest = Manifest.of(plan.output, jobs)
    manifest.write()
    progress(0, len(plan.jobs))
    if scheduler is None:
        count = workers or plan.workers or cores()
        each = threads or max(1, cores() // count)
        outcomes = run_locally(jobs, count, plan.retries, each)
    else:
        outcomes = run_on_cluster(jobs, scheduler, plan.retries)
    for outcome, final in outcomes:
        manifest.record(outcome, final)
        manifest.write()
        progress(manifest.count("done", "kept", "failed"), len(plan.jobs))
    return manifest


def _wanted(scenes: Sequence[Job]) -> Iterator[Job]:
    """Give the scenes' jobs, before each its windows, unless they are joined already."""
    for scene in scenes:
        if scene.after and not is_done(Path(scene.folder), scene.digest()):
            yield from scene.after
        yield scene


def failures(manifest: Manifest) -> str:
    """One line about the scenes that failed; empty if none did."""
    bad = [(name, scene) for name, scene in manifest.whole.items() if scene.status == "failed"]
    if not bad:
        return ""
    name, scene = bad[0]
    more = f", and {len(bad) - 1} more" if len(bad) > 1 else ""
    total, where = len(manifest.whole), manifest.output / NAME
    return f"{len(bad)} of {total} scenes failed: {name} ({scene.message}){more}; see {where}"
