"""Outputs are whole or absent: full disk, no permission, a kill; paths and XML that attack."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scenes import build

from geoposition.errors import GeopositionError
from geoposition.scripts.cli import run
from geoposition.scripts.fuzz.targets import targets
from geoposition.sensors.readers import open_product
from geoposition.sensors.writers.model_file import write_model_file

POINTS = 40_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model and a table of many points."""
    folder = tmp_path_factory.mktemp("in")
    write_model_file(build((700, 600)).model(), folder / "scene.toml")
    rng = np.random.default_rng(5)
    rows = [f"p{k},{r:.3f},{c:.3f}" for k, (r, c) in enumerate(rng.uniform(0, 599, (POINTS, 2)))]
    (folder / "points.csv").write_text("\n".join(["id,row,col", *rows]) + "\n")
    return folder


def jobs(folder: Path, out: Path) -> dict[str, list[str]]:
    """Commands by name; each writes below `out`."""
    model, points = str(folder / "scene.toml"), str(folder / "points.csv")
    return {
        "locate": ["locate", model, points, "--height", "0", "-o", str(out / "out.csv")],
        "locate parquet": ["locate", model, points, "--height", "0", "-o", str(out / "o.parquet")],
        "locate geojson": ["locate", model, points, "--height", "0", "-o", str(out / "o.geojson")],
        "rpc fit": ["rpc", "fit", model, "-o", str(out / "scene.RPB")],
        "rpc fit xml": ["rpc", "fit", model, "-o", str(out / "scene_RPC.XML")],
        "export csm": ["export", model, "-o", str(out / "state.json")],
        "export": ["export", model, "-o", str(out / "copy.toml")],
    }


JOBS = tuple(jobs(Path(), Path()))
COMMAND = "import sys; from geoposition.scripts.cli import main; main(sys.argv[1:])"


def visible(folder: Path) -> set[str]:
    """Names that a user sees; hidden ones are work in progress."""
    return {path.name for path in folder.iterdir() if not path.name.startswith(".")}


@pytest.mark.parametrize("name", JOBS)
def test_a_disk_that_is_full_leaves_what_was_there(
    name: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No file may grow beyond 300 bytes: as a disk that fills up in the middle of each."""
    job = jobs(folder, tmp_path)[name]
    out = Path(job[-1])
    out.write_text("former\n")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (300, limits[1]))
        status = run(job)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
    said = capsys.readouterr().err.strip().splitlines()
    assert status == 2, said
    assert [line for line in said if "internal error" in line] == []
    assert sum(line.startswith("geoposition: ") for line in said) == 1
    assert out.read_text() == "former\n"
    assert [path.name for path in tmp_path.iterdir()] == [out.name]


@pytest.mark.parametrize("name", JOBS)
def test_a_place_that_is_no_place_is_refused(
    name: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Below a file, and in a folder that is not there: before any work, in one line."""
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file", tmp_path / "none"):
        assert run(jobs(folder, place)[name]) == 2
        said = capsys.readouterr().err.strip()
        assert "\n" not in said
        assert "internal error" not in said
    assert visible(tmp_path) == {"file"}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
@pytest.mark.parametrize("name", JOBS)
def test_a_folder_without_permission_is_refused(name: str, folder: Path, tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    assert run(jobs(folder, closed)[name]) == 2
    assert list(closed.iterdir()) == []


@pytest.mark.parametrize("name", ["locate", "rpc fit"])
def test_a_kill_leaves_no_part_under_the_name(name: str, folder: Path, tmp_path: Path) -> None:
    """Killed as soon as it has begun to write beside its place; then it runs again, whole."""
    job = jobs(folder, tmp_path)[name]
    out = Path(job[-1])
    slow = (
        "import time; from pathlib import Path; import geoposition.sensors.writers.table_file as t;"
        "import geoposition.rpc.formats._files as f;"
        "w = Path.replace; Path.replace = lambda a, b: (print('placing', flush=True),"
        " time.sleep(60), w(a, b));"
    )
    work = subprocess.Popen(
        [sys.executable, "-c", slow + COMMAND, *job],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert work.stdout is not None
    begin = time.monotonic()
    for line in work.stdout:
        if line.startswith("placing") or time.monotonic() - begin > 120.0:
            break
    work.send_signal(signal.SIGKILL)
    work.communicate()
    assert work.returncode == -signal.SIGKILL
    assert not out.exists()
    assert list(tmp_path.iterdir()) != []
    assert visible(tmp_path) == set()
    assert run(job) == 0
    assert visible(tmp_path) == {out.name}


@pytest.mark.parametrize("name", JOBS)
def test_a_link_in_the_outputs_place_is_replaced_not_followed(
    name: str, folder: Path, tmp_path: Path
) -> None:
    outputs, victim = tmp_path / "out", tmp_path / "victim"
    outputs.mkdir()
    victim.write_text("mine\n")
    job = jobs(folder, outputs)[name]
    Path(job[-1]).symlink_to(victim)
    assert run(job) == 0
    assert victim.read_text() == "mine\n"
    assert not Path(job[-1]).is_symlink()


@pytest.mark.parametrize(
    "lead", ["../secret.csv", "/etc/passwd", "a/../../secret.csv", "..\\secret.csv", ""]
)
def test_a_model_file_reads_no_table_outside_its_folder(
    lead: str, folder: Path, tmp_path: Path
) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    for path in folder.glob("scene*"):
        (inner / path.name).write_bytes(path.read_bytes())
        (tmp_path / "secret.csv").write_bytes(path.read_bytes())
    text = (inner / "scene.toml").read_text()
    table = next(word for word in text.split('"') if word.endswith(".csv"))
    (tmp_path / "secret.csv").write_bytes((inner / table).read_bytes())
    quoted = lead.replace("\\", "\\\\")
    (inner / "scene.toml").write_text(text.replace(f'"{table}"', f'"{quoted}"'))
    with pytest.raises(GeopositionError) as caught:
        open_product(inner / "scene.toml")
    assert "\n" not in str(caught.value)
    assert "root:" not in str(caught.value)


BOMB = "<!DOCTYPE r [<!ENTITY a 'ha'>" + "".join(
    f"<!ENTITY b{k} '{('&a;' if k == 0 else f'&b{k - 1};') * 10}'>" for k in range(9)
) + "]>"  # fmt: skip
OUTSIDE = "<!DOCTYPE r [<!ENTITY a SYSTEM 'file:///etc/passwd'>]>"
XML_SEEDS = [
    (target.name, target.read, seed)
    for target in targets(None)
    for seed in target.seeds
    if seed.files[seed.main].lstrip().startswith(b"<")
]


@pytest.mark.parametrize("attack", [BOMB, OUTSIDE], ids=["bomb", "outside"])
@pytest.mark.parametrize("seed", XML_SEEDS, ids=lambda each: each[0])
def test_entities_are_refused_by_every_xml_reader(
    seed: tuple,
    attack: str,
    tmp_path: Path,  # type: ignore[type-arg]
) -> None:
    _, read, good = seed
    text = good.files[good.main].decode()
    head, mark, body = text.rpartition("?>")
    at = body.index(">", body.index("<")) + 1
    used = "&b8;" if attack is BOMB else "&a;"
    path = tmp_path / good.main
    path.write_text(head + mark + attack + body[:at] + used + body[at:])
    with pytest.raises(GeopositionError) as caught:
        read(path)
    assert "root:" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_there_are_xml_readers_to_attack() -> None:
    assert len(XML_SEEDS) >= 3
