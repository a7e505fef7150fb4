"""A large image in windows of rows: the same bytes as in one piece, window by window resumable."""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import scenes

from geoposition.calib_fields.synthetic import synthetic_terrain
from geoposition.errors import ArgumentError, ProductError
from geoposition.scripts.batch import run as batch_run
from geoposition.scripts.batch.jobs import Job, Outcome, Queue
from geoposition.scripts.batch.plan import Plan, read_plan
from geoposition.scripts.batch.scene import run_scene
from geoposition.scripts.cli import command_words, run
from geoposition.scripts.results import unseen
from geoposition.scripts.row_windows import Split, Window, windows_rows
from geoposition.sensors.writers.model_file import write_model_file

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SHAPE = (4300, 90)
COUNT = 2
STEPS = """\
[batch]
output = "out"
retries = 0

[[step]]
name = "corners"
command = "locate {product} corners.csv -o {out}/corners.csv --height 300"

[[step]]
name = "steady"
command = "reimage {product} image.tif -o {out}/steady --dem dem.tif"

[[step]]
name = "map"
command = "ortho {product} image.tif -o {out}/map.tif --dem dem.tif --res 2.8 --bound 0.5"

[[scene]]
id = "large"
product = "scene.toml"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("windows")
    jitter = (scenes.Jitter(0, 1.5e-6, 70.0), scenes.Jitter(1, 1.2e-6, 90.0, 1.0))
    model = scenes.build(
        SHAPE, jitter=jitter, attitude="spline", attitude_step_s=0.0005, spare_s=0.9,
        roll_deg=9.0, height_range_m=(0.0, 1500.0),
    ).model()  # fmt: skip
    write_model_file(model, place / "scene.toml")
    middle = model.image_to_ground([2150.0, 45.0], 500.0).geodetic
    synthetic_terrain(
        middle[0], middle[1], 8000.0, 8000.0, seed=3, lowest_m=300.0, highest_m=700.0,
        step_rad=float(np.radians(1.0 / 3600.0)), shortest_m=300.0,
    ).write(place / "dem.tif")  # fmt: skip
    grey = np.random.default_rng(0).integers(1, 4000, SHAPE).astype(np.uint16)
    with rasterio.open(place / "image.tif", "w", driver="GTiff", width=SHAPE[1], height=SHAPE[0],
                       count=1, dtype="uint16", nodata=0) as file:  # fmt: skip
        file.write(grey, 1)
    (place / "corners.csv").write_text("id,row,col\na,0,0\nb,4299,89\n")
    (place / "whole.toml").write_text(STEPS)
    (place / "split.toml").write_text(STEPS + f"windows = {COUNT}\n")
    return place


def plan_of(folder: Path, name: str, output: Path) -> Plan:
    return read_plan(folder / f"{name}.toml", command_words(), output)


def here(jobs: Sequence[Job], workers: int, retries: int, threads: int) -> Iterator[Any]:
    """Run the jobs in this process, as `run_locally` does in others."""
    queue = Queue(jobs, retries)
    while (job := queue.take()) is not None:
        yield from queue.tell(job, run_scene(job))


def done(plan: Plan) -> dict[str, str]:
    """States of all jobs, windows too, when the batch has run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch_run, "run_locally", here)
        manifest = batch_run.run(plan, 1, 1, None, unseen)
    return {name: state.status for name, state in manifest.scenes.items()}


def sums(output: Path) -> dict[str, str]:
    """Fingerprints of a scene's results but for the output's path, when and how fast."""
    times = rb'"(seconds|models|image|mpx_per_s)": [0-9.]+|[0-9: -]+ UTC'
    return {
        path.relative_to(output).as_posix(): hashlib.sha256(
            re.sub(times, b"", path.read_bytes().replace(str(output).encode(), b""))
        ).hexdigest()
        for path in sorted(output.rglob("large/**/*"))
        if path.is_file() and path.name != "scene.json"
    }


@pytest.fixture(scope="module")
def whole(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    output = tmp_path_factory.mktemp("whole")
    assert done(plan_of(folder, "whole", output)) == {"large": "done"}
    with rasterio.open(output / "large" / "steady" / "steady.tif") as steady:
        assert np.count_nonzero(steady.read(1)) > 0.9 * SHAPE[0] * SHAPE[1]
    return sums(output)


def test_windows_give_the_same_bytes_and_are_gone(
    folder: Path, tmp_path: Path, whole: dict[str, str]
) -> None:
    plan = plan_of(folder, "split", tmp_path)
    names = [f"large.{k}of{COUNT}" for k in range(1, COUNT + 1)]
    assert [part.id for part in plan.jobs[0].after] == names
    assert done(plan) == dict.fromkeys([*names, "large"], "done")
    assert sums(tmp_path) == whole
    assert not list(tmp_path.glob("large.*"))
    assert done(plan) == {"large": "kept"}
    facts = json.loads((tmp_path / "manifest.json").read_text())
    assert (facts["scenes"], facts["done"], facts["kept"]) == (1, 1, 1)


def test_a_resumed_run_makes_only_the_windows_that_are_missing(
    folder: Path, tmp_path: Path, whole: dict[str, str]
) -> None:
    path = folder / "steady.toml"
    path.write_text((folder / "split.toml").read_text() + 'steps = ["steady"]\n')
    plan = plan_of(folder, "steady", tmp_path)
    first, second = plan.jobs[0].after
    assert run_scene(first).status == "done"
    (tmp_path / second.id).mkdir()
    (tmp_path / second.id / ".begun").touch()  # killed at work
    assert done(plan) == {first.id: "kept", second.id: "done", "large": "done"}
    lines = (tmp_path / ".batch" / "journal.jsonl").read_text().splitlines()
    events = Counter((line["id"], line["event"]) for line in map(json.loads, lines))
    assert events[first.id, "begun"] == 1
    found = sums(tmp_path)
    assert len(found) > 10
    assert found == {name: whole[name] for name in found}


def test_a_window_of_another_run_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["reimage", str(folder / "scene.toml"), str(folder / "image.tif"), "--json"]
    common += ["-o", str(tmp_path / "steady"), "--windows", str(tmp_path / "w1")]
    assert run([*common, "--height", "300", "--window", "1/2"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["rows"] == [0, 2048]
    assert not (tmp_path / "steady").exists()
    assert run([*common, "--height", "301"]) == 2
    assert "a window of the same run expected" in capsys.readouterr().err
    assert run([*common, "--height", "300"]) == 2
    assert "windows of 4300 rows expected, got 2048" in capsys.readouterr().err
    assert not (tmp_path / "steady").exists()
    next((tmp_path / "w1").glob("*-pixels.npy")).write_bytes(b"\x93NUMPY\x01\x00v\x00{'descr")
    assert run([*common, "--height", "300"]) == 2
    assert "not readable" in capsys.readouterr().err


def test_a_window_that_fails_fails_its_scene(folder: Path, tmp_path: Path) -> None:
    broken = folder / "broken.toml"
    text = (folder / "split.toml").read_text().replace("map.tif --dem dem", "map.tif --dem no")
    broken.write_text(text)
    states = done(plan_of(folder, "broken", tmp_path))
    assert set(states.values()) == {"failed"}
    facts = json.loads((tmp_path / "manifest.json").read_text())
    assert (facts["scenes"], facts["failed"]) == (1, 1)
    assert "large.1of2: map: " in facts["states"]["large"]["message"]


def test_windows_are_whole_strips_and_cover_all_rows() -> None:
    for total, count in ((20_000, 7), (500, 3), (1024, 2), (1025, 1), (900, 5)):
        spans = [Window(k, count).rows(total, 512) for k in range(1, count + 1)]
        assert spans[0][0] == 0
        assert spans[-1][1] == total
        assert all(a[1] == b[0] for a, b in pairwise(spans))
        assert all(first % 512 == 0 for first, _ in spans)
    for words in ("0/3", "4/3", "2", "1/0", "-1/2", "1/2/3"):
        with pytest.raises(ArgumentError, match="K/N expected"):
            Window.of(words)
    with pytest.raises(ArgumentError, match="one folder"):
        Split.of("1/2", [])
    with pytest.raises(ProductError, match="there is none"):
        list(windows_rows([Path("nowhere")], {}, 10, ["pixels"]))


def test_only_what_can_be_split_takes_windows(folder: Path, tmp_path: Path) -> None:
    for change, message in (
        ('steps = ["corners"]\n', "a step that can be split"),
        ('steps = ["nothing"]\n', "a list of corners, map, steady expected"),
        ("steps = []\n", "a list of"),
    ):
        path = folder / "bad.toml"
        path.write_text((folder / "split.toml").read_text() + change)
        with pytest.raises(ProductError, match=message):
            read_plan(path, command_words(), tmp_path)


def test_a_scene_goes_through_the_steps_that_it_names(folder: Path, tmp_path: Path) -> None:
    path = folder / "some.toml"
    path.write_text(STEPS + 'steps = ["map", "corners"]\n')
    (job,) = read_plan(path, command_words(), tmp_path).jobs
    assert [name for name, _ in job.commands] == ["corners", "map"]


def test_a_queue_waits_for_windows_and_tries_again() -> None:
    parts = tuple(Job(name, "", name, ()) for name in "ab")
    whole = Job("whole", "", "whole", (), parts)
    queue = Queue([*parts, whole], retries=1)
    first, second = queue.take(), queue.take()
    assert (first, second, queue.take()) == (*parts, None)
    assert first is not None
    assert second is not None
    assert [last for _, last in queue.tell(first, Outcome("a", "lost"))] == [False]
    assert queue.take() == first
    assert [last for _, last in queue.tell(second, Outcome("b", "kept"))] == [True]
    assert queue.take() is None
    assert [last for _, last in queue.tell(first, Outcome("a", "done"))] == [True]
    assert queue.take() == whole
    assert not queue
