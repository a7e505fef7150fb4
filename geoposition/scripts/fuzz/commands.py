"""Mutated real products through the command line: right, or refused in one line."""

from __future__ import annotations

import io
import random
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from geoposition.scripts.cli import run as run_command
from geoposition.scripts.fuzz.campaign import Tally
from geoposition.scripts.fuzz.mutations import mutate
from geoposition.scripts.results import Progress

_METADATA: Final = (".xml", ".imd", ".att", ".eph", ".geo", ".rpb", ".json", ".txt", ".geom")
_LARGEST: Final = 12_000_000


def run(data: Path, count: int, seed: int, progress: Progress) -> Tally:
    """Mutate `count` products' metadata; `info` and `locate` on each."""
    warnings.simplefilter("ignore")
    products = _products(data)
    rng = random.Random(seed)
    tally = Tally("products on the command line")
    for k in range(count):
        path = products[k % len(products)]
        with TemporaryDirectory(prefix="fuzz-") as name:
            _try(path, rng, Path(name), tally)
        progress(k + 1, count)
    return tally


def _products(data: Path) -> list[Path]:
    """Metadata files that `info` reads as they are."""
    found = []
    for path in sorted((data / "linescan").rglob("*")) + sorted((data / "rpc").glob("*")):
        fits = path.suffix.lower() in _METADATA and path.stat().st_size <= _LARGEST
        if path.is_file() and fits and _told(["info", str(path), "--json"])[0] == 0:
            found.append(path)
    return found


def _try(path: Path, rng: random.Random, folder: Path, tally: Tally) -> None:
    """Mutate the product's file, or one beside it that belongs to it."""
    family = [
        other
        for other in path.parent.iterdir()
        if other.is_file() and other.suffix.lower() in _METADATA
        and other.stat().st_size <= _LARGEST
    ]  # fmt: skip
    victim = path if rng.random() < 0.7 else rng.choice(family)
    files = {other.name: other.read_bytes() for other in family}
    files[victim.name] = mutate(files[victim.name], rng)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (folder / "points.csv").write_text("id,row,col\na,0,0\nb,100.5,200.25\nc,-5000,3\n")
    product, out = str(folder / path.name), folder / "out.csv"
    kept = {victim.name: files[victim.name]}
    for words in (
        ["info", product, "--json"],
        ["locate", product, str(folder / "points.csv"), "-o", str(out), "--height", "100"],
    ):
        status, said = _told(words)
        if status not in (0, 2) or "Traceback" in said or "internal error" in said:
            tally.findings.append(("traceback", f"{words[0]} {path.name}: {said[-600:]}", kept))
        elif status == 2 and len(said.strip().splitlines()) != 1:
            tally.findings.append(("not one line", f"{words[0]} {path.name}: {said[:600]}", kept))
        elif status == 2 and words[0] == "locate" and out.exists():
            tally.findings.append(("output of a refusal", f"{path.name}", kept))
        elif status == 2:
            tally.refused += 1
        else:
            tally.read += 1


def _told(words: list[str]) -> tuple[int, str]:
    said = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(said):
        status = run_command(words)
    return status, said.getvalue()
