"""Forty scenes one by one, by the batch, by two workers, and by a cluster under fire.

Run it with `python -m geoposition.scripts.bench.batch_scale`: it makes scenes of four kinds of
work (RPC, location, re-imaging, evaluation), runs them with one thread each

1. by the single commands, one after the other in one process,
2. by `batch` with one worker and 3. with two, each in a new process,
4. by `batch --scheduler` on a Dask LocalCluster, two of whose workers and the driver are killed;
   the driver is then started again,

and compares: what was done, how often, the bytes, and the time. Exit status 1 if any is wrong.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from statistics import mean
from tempfile import TemporaryDirectory
from typing import Any, Final

from geoposition.scripts.batch.plan import Plan, read_plan
from geoposition.scripts.batch.scene import MARK
from geoposition.scripts.bench.batch_results import contents, count_of, events
from geoposition.scripts.bench.batch_scenes import KINDS, write_scenes
from geoposition.scripts.cli import command_words, run
from geoposition.scripts.processes import threads_each

SCENES: Final = 40
SIZE: Final = 1024
TARGET: Final = 1.8
"""How many times faster two workers are expected to be than one."""

_CLUSTER_KILLS: Final = (0.15, 0.35)
_DRIVER_KILL: Final = 0.55
_PATIENCE_S: Final = 900.0


def main(arguments: list[str] | None = None) -> int:
    """Run all of it; prints words, and with --json one object."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scenes", type=int, default=SCENES)
    parser.add_argument("--size", type=int, default=SIZE, help="lines and samples of the images")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--singly", nargs=1, type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.singly:
        return _run_singly(read_plan(given.singly[0], command_words()))
    with TemporaryDirectory() as name, threads_each(1):
        facts = measured(Path(name), given.scenes, given.size)
    if given.json:
        print(json.dumps(facts))
    else:
        for key, value in facts.items():
            print(f"{key:28} {value}")
    return 0 if facts["all right"] else 1


def measured(folder: Path, scenes: int, size: int) -> dict[str, Any]:
    """Run the scenes in all ways; returns figures."""
    plan_file = write_scenes(folder, scenes, size)
    plan = read_plan(plan_file, command_words())
    module = [sys.executable, "-m", "geoposition.scripts"]
    batch = [*module, "batch", str(plan_file), "--threads", "1", "--json"]
    warm = [sys.executable, "-m", __spec__.name, "--singly", str(plan_file)]
    facts: dict[str, Any] = {"scenes": scenes, "image": f"{size} x {size} pixels"}
    facts["first run, s"] = _timed(warm, plan, "first")  # compiles what is not compiled yet
    facts["one by one, s"] = _timed(warm, plan, "singly")
    alone = contents(folder / "singly")
    checks = {}
    for workers in (1, 2):
        name = f"{workers} local"
        facts[f"{name}, s"] = _timed([*batch, "--workers", str(workers)], plan, name)
        checks[name] = _wrong(folder / name, plan, alone)
    facts["seconds by kind"] = _by_kind(folder / "1 local")
    facts["disk by kind, MB"] = _disk_by_kind(folder / "1 local")
    facts["speed-up of 2 over 1"] = round(facts["1 local, s"] / facts["2 local, s"], 2)
    with _cluster() as cluster:
        begin = time.perf_counter()
        killed = _under_fire([*batch, "--scheduler", cluster.scheduler_address], cluster, plan)
        facts["cluster under fire, s"] = round(time.perf_counter() - begin, 1)
    facts["killed"] = killed
    plan.output.rename(folder / "cluster")
    checks["cluster"] = _wrong(folder / "cluster", plan, alone)
    facts["begun again"] = count_of(folder / "cluster", "begun") - scenes
    facts["wrong"] = {name: found for name, found in checks.items() if found} or "nothing"
    facts["files compared, each way"] = len(alone)
    facts["all right"] = not any(checks.values())
    return facts


def _timed(command: list[str], plan: Plan, name: str) -> float:
    """Seconds of `command`, whose results are moved to `name`: all are made at one path."""
    begin = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    seconds = time.perf_counter() - begin
    plan.output.rename(plan.output.parent / name)
    return round(seconds, 1)


def _run_singly(plan: Plan) -> int:
    """Run what the plan says without the batch: the commands as one would type them."""
    for job in plan.jobs:
        folder = Path(job.folder)
        folder.mkdir(parents=True)
        os.chdir(job.base)
        for name, words in job.commands:
            with (
                (folder / f"{name}.json").open("w", encoding="utf-8") as out,
                (folder / f"{name}.log").open("w", encoding="utf-8") as log,
                redirect_stdout(out),
                redirect_stderr(log),
            ):
                status = run([*words, "--json"])
            if status != 0:
                print((folder / f"{name}.log").read_text(encoding="utf-8"), file=sys.stderr)
                return status
    return 0


@contextmanager
def _cluster() -> Iterator[Any]:
    from distributed import LocalCluster

    with LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as cluster:
        yield cluster


def _under_fire(command: list[str], cluster: Any, plan: Plan) -> dict[str, Any]:
    """Run the batch; kill a worker twice and the driver once, each when some scenes are done."""
    dead: list[int] = []
    killed: list[int] = []
    total = len(plan.jobs)
    driver = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    for share in _CLUSTER_KILLS:
        _wait_for(plan.output, share * total)
        killed.append(_kill_a_worker(cluster, killed))
        dead.append(count_of(plan.output, "done"))
    _wait_for(plan.output, _DRIVER_KILL * total)
    driver.kill()
    driver.wait()
    at = count_of(plan.output, "done")
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    resumed = json.loads(done.stdout)
    return {
        "workers, when so many were done": dead,
        "driver, when so many were done": at,
        "kept by the resumed run": resumed["kept"],
    }


def _kill_a_worker(cluster: Any, killed: list[int]) -> int:
    """Kill a worker that is alive, also where a dead one has not been replaced yet."""
    deadline = time.monotonic() + _PATIENCE_S
    while time.monotonic() < deadline:
        for worker in list(cluster.workers.values()):
            pid = worker.pid
            if pid is not None and pid not in killed:
                os.kill(pid, signal.SIGKILL)
                return int(pid)
        time.sleep(0.05)
    raise SystemExit("batch_scale: the cluster has no worker")


def _wait_for(output: Path, scenes: float) -> None:
    deadline = time.monotonic() + _PATIENCE_S
    while count_of(output, "done") < scenes:
        if time.monotonic() > deadline:
            raise SystemExit("batch_scale: the cluster does nothing")
        time.sleep(0.05)


def _wrong(output: Path, plan: Plan, alone: dict[str, str]) -> list[str]:
    """List what is lost, done twice, or not the same as in the single runs."""
    journal, found = events(output), contents(output)
    wrong = [f"{job.id} done {journal[job.id, 'done']} times" for job in plan.jobs
             if journal[job.id, "done"] != 1]  # fmt: skip
    wrong += [f"{job.id} has no mark" for job in plan.jobs
              if not (output / job.id / MARK).exists()]  # fmt: skip
    return wrong + [f"{name} differs" for name in sorted(found.keys() | alone.keys())
                    if found.get(name) != alone.get(name)]  # fmt: skip


def _by_kind(output: Path) -> dict[str, float]:
    """Mean seconds of each kind of scene; its first one, which loads the kernels, left out."""
    states = json.loads((output / "manifest.json").read_text(encoding="utf-8"))["states"]
    return {
        kind: round(mean([state["seconds"] for name, state in states.items()
                          if name.endswith(kind)][1:] or [0.0]), 2)
        for kind in KINDS
    }  # fmt: skip


def _disk_by_kind(output: Path) -> dict[str, float]:
    sizes = {
        kind: [sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
               for folder in output.glob(f"*-{kind}")]
        for kind in KINDS
    }  # fmt: skip
    return {kind: round(mean(found) / 1e6, 2) for kind, found in sizes.items()}


if __name__ == "__main__":
    sys.exit(main())
