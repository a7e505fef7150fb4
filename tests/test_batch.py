"""Many scenes: done once each, the same as one by one, whatever is killed meanwhile."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest
import scenes

from geoposition.errors import MissingFileError, ProductError
from geoposition.scripts.batch.local import run_locally
from geoposition.scripts.batch.plan import EXAMPLE, Plan, read_plan
from geoposition.scripts.batch.scene import run_scene
from geoposition.scripts.cli import command_words, run
from geoposition.sensors.writers.model_file import write_model_file

SCENES = 4
RUN = """\
[batch]
output = "out"
retries = 2

[[step]]
name = "rpc"
command = "rpc fit {product} -o '{out}/image RPC.TXT'"

[[step]]
command = ["locate", "{product}", "{points}", "-o", "{out}/ground.csv", "--height", "{height}"]

[defaults]
points = "points.csv"
height = 150

"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("batch")
    (path / "points.csv").write_text("id,row,col\na,10,20\nb,900,1300\n")
    text = RUN
    for k in range(SCENES):
        (path / f"strip {k}").mkdir()
        model = scenes.build((2000, 1500), roll_deg=3.0 * k).model()
        write_model_file(model, path / f"strip {k}" / "scene.toml", sensor="synthetic")
        text += f'[[scene]]\nid = "s{k}"\nproduct = "strip {k}/scene.toml"\n\n'
    (path / "RUN.toml").write_text(text)
    return path


def plan_of(folder: Path, output: Path) -> Plan:
    return read_plan(folder / "RUN.toml", command_words(), output)


def sums(output: Path) -> dict[str, str]:
    """Fingerprints of all results; the output's own path does not count."""
    return {
        path.relative_to(output).as_posix(): hashlib.sha256(
            path.read_bytes().replace(str(output).encode(), b"")
        ).hexdigest()
        for path in sorted(output.glob("s*/*"))
        if path.name != "scene.json"
    }


def events(output: Path) -> Counter[tuple[str, str]]:
    lines = (output / ".batch" / "journal.jsonl").read_text().splitlines()
    return Counter((line["id"], line["event"]) for line in map(json.loads, lines))


def done_once(output: Path) -> bool:
    return all(events(output)[f"s{k}", "done"] == 1 for k in range(SCENES))


@pytest.fixture(scope="module")
def alone(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What the scenes give one by one, with one thread: more add in another order."""
    output = tmp_path_factory.mktemp("alone")
    for outcome, _ in run_locally(plan_of(folder, output).jobs, 1, retries=0, threads=1):
        assert outcome.status == "done"
    found = sums(output)
    assert len(found) == 6 * SCENES
    return found


def test_a_killed_worker_loses_no_scene(
    folder: Path, tmp_path: Path, alone: dict[str, str]
) -> None:
    killed: list[int] = []
    final = Counter[str]()
    for outcome, last in run_locally(plan_of(folder, tmp_path).jobs, 2, retries=2, threads=1):
        if last:
            final[outcome.status] += 1
        if len(killed) < 2 and outcome.status != "lost":
            victim = multiprocessing.active_children()[0]
            assert victim.pid is not None
            os.kill(victim.pid, signal.SIGKILL)
            killed.append(victim.pid)
    assert len(killed) == 2
    assert final == {"done": SCENES}
    assert done_once(tmp_path)
    assert sums(tmp_path) == alone


def test_a_killed_driver_is_taken_up_again(
    folder: Path, tmp_path: Path, alone: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["batch", str(folder / "RUN.toml"), "-o", str(tmp_path), "--workers", "1"]
    words += ["--threads", "1", "--json"]
    driver = subprocess.Popen([sys.executable, "-m", "geoposition.scripts", *words])
    deadline = time.monotonic() + 60.0
    while not list(tmp_path.glob("s*/scene.json")):
        assert time.monotonic() < deadline
        assert driver.poll() is None
        time.sleep(0.02)
    driver.kill()
    driver.wait()
    capsys.readouterr()
    assert run(words) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["done"] == SCENES
    assert facts["kept"] >= 1
    assert facts["states"]["s0"] | {"seconds": 0} == {
        "status": "kept", "tries": 0, "seconds": 0, "message": "", "folder": str(tmp_path / "s0"),
    }  # fmt: skip
    assert json.loads((tmp_path / "manifest.json").read_text()) == facts
    assert done_once(tmp_path)
    assert sums(tmp_path) == alone
    assert run(words) == 0
    assert json.loads(capsys.readouterr().out)["kept"] == SCENES
    assert done_once(tmp_path)


def test_a_cluster_gives_the_same_and_survives_a_worker(
    folder: Path, tmp_path: Path, alone: dict[str, str]
) -> None:
    distributed = pytest.importorskip("distributed")
    from geoposition.scripts.batch.cluster import run_on_cluster

    jobs = plan_of(folder, tmp_path).jobs
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0"
    ) as cluster:
        statuses = []
        for outcome, last in run_on_cluster(jobs, cluster.scheduler_address, retries=1):
            if not statuses:
                os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
            assert last
            statuses.append(outcome.status)
    assert Counter(statuses)["done"] + Counter(statuses)["kept"] == SCENES
    assert done_once(tmp_path)
    assert sums(tmp_path) == alone


def test_what_fails_is_named_and_the_rest_is_done(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (folder / "RUN.toml").read_text().replace("strip 1/scene.toml", "strip 9/scene.toml")
    broken = folder / "broken.toml"
    broken.write_text(text)
    assert run(["batch", str(broken), "-o", str(tmp_path), "--workers", "1", "--json"]) == 2
    out, err = capsys.readouterr()
    facts = json.loads(out)
    assert (facts["done"], facts["failed"]) == (SCENES - 1, 1)
    assert facts["states"]["s1"]["tries"] == 3
    assert "strip 9/scene.toml" in facts["states"]["s1"]["message"]
    assert err.count("\n") == 1
    assert f"1 of {SCENES} scenes failed: s1" in err
    assert not (tmp_path / "s1" / "scene.json").exists()


def test_a_changed_input_is_run_again(folder: Path, tmp_path: Path) -> None:
    job = plan_of(folder, tmp_path).jobs[0]
    assert run_scene(job).status == "done"
    assert run_scene(job).status == "kept"
    points = folder / "points.csv"
    os.utime(points, ns=(1, points.stat().st_mtime_ns + 1))
    assert run_scene(job).status == "done"


def test_a_folder_that_is_no_scene_is_left_alone(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "s0").mkdir()
    (tmp_path / "s0" / "thesis.doc").write_text("years of work")
    outcome = run_scene(plan_of(folder, tmp_path).jobs[0])
    assert outcome.status == "failed"
    assert "other files" in outcome.message
    assert (tmp_path / "s0" / "thesis.doc").read_text() == "years of work"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("rpc fit", "rpc destroy"), "a command of geoposition expected"),
        (("rpc fit", "batch again"), "a command of geoposition expected"),
        (("{product} -o", "{picture} -o"), "scene[0].picture"),
        (('id = "s1"', 'id = "S0"'), "two scenes are called"),
        (('id = "s1"', 'id = "../s1"'), "letters, digits"),
        (('output = "out"', ""), "batch.output"),
        (("retries = 2", "retires = 2"), "batch.retires"),
        (('product = "strip 0/scene.toml"', 'product = "strip*/nothing"'), "no file matches"),
        (("[defaults]", "[default]"), "default: there is no such key"),
        (("[defaults]\n", "[defaults]\nout = 'here'\n"), "this name is taken"),
    ],
)
def test_a_bad_plan_is_refused_before_anything_runs(
    change: tuple[str, str], message: str, folder: Path, tmp_path: Path
) -> None:
    bad = folder / "bad.toml"
    text = (folder / "RUN.toml").read_text()
    assert change[0] in text
    bad.write_text(text.replace(*change))
    with pytest.raises(ProductError, match=r"bad\.toml") as error:
        read_plan(bad, command_words() - {("batch",)})
    assert message in str(error.value)


def test_patterns_and_the_example(folder: Path, tmp_path: Path) -> None:
    text = RUN + '[[scene]]\nproduct = "strip*/scene.toml"\n'
    (folder / "pattern.toml").write_text(text)
    jobs = read_plan(folder / "pattern.toml", command_words(), tmp_path).jobs
    assert [job.id for job in jobs] == [f"strip_{k}-scene" for k in range(SCENES)]
    (tmp_path / "RUN.toml").write_text(EXAMPLE)
    (tmp_path / "strip_7").mkdir()
    (tmp_path / "strip_7" / "IMG.XML").touch()
    plan = read_plan(tmp_path / "RUN.toml", command_words())
    assert [job.id for job in plan.jobs] == ["north", "IMG"]
    assert plan.workers == 2
    with pytest.raises(MissingFileError):
        read_plan(tmp_path / "absent.toml", command_words())
