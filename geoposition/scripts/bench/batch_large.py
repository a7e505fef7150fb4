"""One large image by the batch: whole by one worker, then in windows of rows by two.

Run it with `python -m geoposition.scripts.bench.batch_large`: same bytes, and how much faster.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from geoposition.scripts.bench.batch_results import contents
from geoposition.scripts.bench.remap_scene import image_file, shaken_model
from geoposition.sensors.writers.model_file import write_model_file

LINES: Final = 20_000
SAMPLES: Final = 4096
WINDOWS: Final = 4

_RUN: Final = """\
[batch]
output = "out"

[[step]]
name = "steady"
command = "reimage {{product}} image.tif -o {{out}}/steady --height 300"

[[scene]]
id = "large"
product = "{product}"
windows = {windows}
"""


def measured(folder: Path, lines: int, samples: int, windows: int) -> dict[str, Any]:
    """Re-image one image of `lines` x `samples` pixels both ways; returns figures."""
    facts: dict[str, Any] = {"image": f"{lines} x {samples} pixels", "windows": windows}
    image_file(folder / "image.tif", lines, samples)
    write_model_file(shaken_model(lines, samples), folder / "scene.toml", sensor="simulated")
    image_file(folder / "small" / "image.tif", 512, 512)
    write_model_file(shaken_model(512, 512), folder / "small" / "scene.toml", sensor="simulated")
    _run(folder / "small", 1, 1)  # compiles what is not compiled yet
    for name, count, workers in (("whole", 1, 1), ("in windows", windows, 2)):
        begin = time.perf_counter()
        _run(folder, count, workers)
        facts[f"{name}, s"] = round(time.perf_counter() - begin, 1)
        (folder / "out").rename(folder / name)
    states = json.loads((folder / "in windows" / "manifest.json").read_text())["states"]
    facts["seconds of each"] = {name: state["seconds"] for name, state in states.items()}
    whole, split = (contents(folder / name / "large") for name in ("whole", "in windows"))
    facts["files that differ"] = [
        name for name in sorted(whole.keys() | split.keys()) if whole.get(name) != split.get(name)
    ]
    facts["files compared"] = len(whole)
    facts["windows left behind"] = len(list((folder / "in windows").glob("large.*")))
    return facts


def _run(folder: Path, windows: int, workers: int) -> None:
    plan = folder / "RUN.toml"
    plan.write_text(_RUN.format(product="scene.toml", windows=windows), encoding="utf-8")
    command = [sys.executable, "-m", "geoposition.scripts", "batch", str(plan), "--json"]
    command += ["--threads", "1", "--workers", str(workers)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def main() -> None:
    """Print the figures; exit status 1 if a byte differs."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--lines", type=int, default=LINES)
    parser.add_argument("--samples", type=int, default=SAMPLES)
    parser.add_argument("--windows", type=int, default=WINDOWS)
    given = parser.parse_args()
    with TemporaryDirectory() as name:
        (Path(name) / "small").mkdir()
        facts = measured(Path(name), given.lines, given.samples, given.windows)
    for key, value in facts.items():
        print(f"{key:24} {value}")
    sys.exit(1 if facts["files that differ"] or facts["windows left behind"] else 0)


if __name__ == "__main__":
    main()
