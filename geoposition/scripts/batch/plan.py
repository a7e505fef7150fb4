"""RUN.toml of a batch: which steps every scene goes through, and which scenes there are.

A step is a command line of this program; {name} in it stands for the scene's key of that name,
{id} for its id, {out} for its folder and {base} for the folder of RUN.toml, in which commands
run. A scene may name the steps it goes through, and be split into windows of rows (`windows`).
"""

from __future__ import annotations

import glob
import re
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from geoposition.errors import ProductError
from geoposition.scripts.batch.jobs import Job
from geoposition.scripts.batch.windows import MOST_WINDOWS, SPLIT, joined, window_names
from geoposition.tomlfile import TomlNode, read_toml

EXAMPLE: Final = """\
# geoposition batch RUN.toml: every scene goes through every step.
[batch]
output = "out"            # one folder per scene in it; -o wins
workers = 2               # local processes; as many as there are cores if left out
retries = 2               # how often a scene that failed is tried again

[[step]]                  # {key} is the scene's key, {id} its id, {out} its folder
name = "rpc"
command = "rpc fit {product} -o {out}/image_RPC.TXT --report {out}/rpc.html"

[[step]]
name = "corners"
command = "locate {product} {points} -o {out}/corners.csv --height 200"

[defaults]                # keys of every scene that does not set them itself
points = "corners.csv"    # relative to this file

[[scene]]
id = "north"
product = "north/IMG.XML"

[[scene]]
product = "strip_*/*.XML" # one scene per match, named after it
steps = ["rpc"]           # of the above; all of them if left out
# windows = 4             # reimage and ortho: rows in so many parts, by as many workers
"""

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_PLACEHOLDER: Final = re.compile(r"\{([A-Za-z_]\w*)\}")
_TAKEN: Final = {"out", "base"}
_NOT_TEXT: Final = {"steps", "windows"}
_MOST_RETRIES: Final = 100
_MOST_WORKERS: Final = 4096


@dataclass(frozen=True, slots=True)
class Step:
    """One command of a scene: its name and its arguments, placeholders still in them."""

    name: str
    arguments: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """What to run: a job for each scene in the file's order, their folder, how hard to try."""

    output: Path
    jobs: tuple[Job, ...]
    workers: int | None
    retries: int


def read_plan(path: Path, commands: frozenset[tuple[str, ...]], output: Path | None = None) -> Plan:
    """Read RUN.toml; `commands` are the known ones, as words. `output` replaces the file's.

    Errors name the key: no such command, a placeholder no scene fills, two scenes of one name.
    """
    root = read_toml(path)
    root.asked.update(("batch", "step", "defaults", "scene"))
    root.finish()
    base = path.parent.resolve()
    own = root.child("batch") if root.has("batch") else TomlNode(path, "batch", {})
    named = own.text("output", "")
    if output is None and not named:
        own.refuse("output", "a folder for the results expected, here or with -o")
    folder = (base / named if output is None else output).resolve()
    workers = own.whole("workers", 1, _MOST_WORKERS) if own.has("workers") else None
    retries = own.whole("retries", 0, _MOST_RETRIES) if own.has("retries") else 2
    own.finish()
    steps = _steps(root, commands)
    shared = _texts(root.child("defaults")) if root.has("defaults") else {}
    jobs = []
    for node in root.children("scene"):
        own_steps = _chosen(node, steps)
        count = _windows(node, own_steps)
        for name, keys in _scenes(node, shared, base):
            job = _job(node, name, keys, own_steps, base, folder / name)
            if count > 1:
                job = joined(job, [
                    replace(_job(node, name, keys, own_steps, base, folder / part), id=part)
                    for part in window_names(name, count)
                ])  # fmt: skip
            jobs.append(job)
    names = Counter(part.id.casefold() for job in jobs for part in (job, *job.after))
    twice = next((job.id for job in jobs if names[job.id.casefold()] > 1), None)
    if twice is not None:
        raise ProductError(path, "scene.id", f"two scenes are called {twice!r}")
    return Plan(folder, tuple(jobs), workers, retries)


def _steps(root: TomlNode, commands: frozenset[tuple[str, ...]]) -> list[Step]:
    steps: list[Step] = []
    for node in root.children("step"):
        name = node.text("name", "")
        value = node.need("command")
        if isinstance(value, str):
            try:
                words = tuple(shlex.split(value))
            except ValueError as error:
                node.refuse("command", f"a command line expected: {error}")
        elif isinstance(value, list) and all(isinstance(word, str) for word in value):
            words = tuple(value)
        else:
            node.refuse("command", "a command line, or a list of its words, expected")
        if words[:1] == ("geoposition",):
            words = words[1:]
        known = next((words[:n] for n in (2, 1) if words[:n] in commands), None)
        if known is None:
            node.refuse(
                "command", f"a command of geoposition expected, got {' '.join(words)[:60]!r}"
            )
        node.finish()
        name = name or "-".join(known)
        if not _NAME.fullmatch(name):
            node.refuse("name", f"letters, digits, '.', '_' and '-' expected, got {name[:40]!r}")
        if name in {step.name for step in steps}:
            node.refuse("name", f"two steps are called {name!r}")
        steps.append(Step(name, words))
    return steps


def _chosen(node: TomlNode, steps: list[Step]) -> list[Step]:
    """Return the steps that a scene names, in the file's order; all if it names none."""
    names = node.data.get("steps", [step.name for step in steps])
    known = {step.name for step in steps}
    if not isinstance(names, list) or not names or not set(map(str, names)) <= known:
        node.refuse("steps", f"a list of {', '.join(sorted(known))} expected, got {names}")
    return [step for step in steps if step.name in names]


def _windows(node: TomlNode, steps: list[Step]) -> int:
    """Windows of a scene; 1 if it stays whole."""
    if not node.has("windows"):
        return 1
    if not any(step.arguments[0] in SPLIT for step in steps):
        node.refuse("windows", f"a step that can be split ({', '.join(sorted(SPLIT))}) expected")
    return node.whole("windows", 1, MOST_WINDOWS)


def _texts(node: TomlNode) -> dict[str, str]:
    """Values of a table as the command line has them."""
    found = {}
    for key, value in node.data.items():
        if key in _NOT_TEXT:
            continue
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            node.refuse(key, "a string or a number expected")
        if key in _TAKEN:
            node.refuse(key, "this name is taken")
        found[key] = str(value)
    return found


def _scenes(
    node: TomlNode, shared: Mapping[str, str], base: Path
) -> Iterator[tuple[str, dict[str, str]]]:
    """Names and keys of one [[scene]]: several where its product is a pattern."""
    own = _texts(node)
    keys = {**shared, **own}
    product = own.get("product", "")
    if not glob.has_magic(product) or (base / product).exists():
        name = keys.pop("id", "") or _name_of(Path(product))
        if not _NAME.fullmatch(name):
            node.refuse("id", f"letters, digits, '.', '_' and '-' expected, got {name[:40]!r}")
        yield name, keys
        return
    # Path.glob takes no absolute pattern.
    matches = sorted(glob.glob(product, root_dir=base, recursive=True))  # noqa: PTH207
    if not matches:
        node.refuse("product", f"no file matches {product!r}")
    stems = [_name_of(Path(match)) for match in matches]
    unique = len(set(stems)) == len(stems)
    prefix = own.get("id", "")
    for match, stem in zip(matches, stems, strict=True):
        name = stem if unique else _name_of(Path(match.replace("/", "-")))
        yield f"{prefix}{name}", {**keys, "product": match}


def _name_of(path: Path) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "_", path.stem).lstrip("._-") or "scene"


def _job(
    node: TomlNode, name: str, keys: Mapping[str, str], steps: list[Step], base: Path, folder: Path
) -> Job:
    known = {**keys, "id": name, "out": str(folder), "base": str(base)}
    for step in steps:
        for key in _PLACEHOLDER.findall(" ".join(step.arguments)):
            if key not in known:
                node.refuse(key, f"this key is missing; the step {step.name!r} needs it")
    commands = tuple(
        (step.name, tuple(_PLACEHOLDER.sub(lambda m: known[m[1]], word) for word in step.arguments))
        for step in steps
    )
    return Job(name, str(base), str(folder), commands)
