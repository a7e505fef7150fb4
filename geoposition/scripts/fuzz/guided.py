"""Inputs guided by coverage: atheris grows those that reach new code. The only door to it."""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType
from typing import Any, Final

from geoposition.errors import ArgumentError, GeometryError
from geoposition.scripts.fuzz.campaign import Tally, judge, save, summary
from geoposition.scripts.fuzz.mutations import mutate
from geoposition.scripts.fuzz.targets import Seed, targets

_WATCHED: Final = ("geoposition.sensors.readers", "geoposition.rpc.formats", "geoposition.xmlfile")
_LONGEST: Final = 65_536
_CORPUS, _INPUT, _SUMMARY = "corpus", "input", "summary.json"


def run(data: Path | None, name: str, inputs: int, seed: int, keep: Path) -> dict[str, object]:
    """Feed `inputs` to the targets whose name holds `name`, guided by the code they reach.

    An input's first byte chooses one of the targets' seeds, whose main file the rest is. New
    inputs are made by `mutations` of those that reached new code. Returns facts fit for JSON.

    Raises
    ------
    ArgumentError
        atheris is not installed, or no target has such a name.
    GeometryError
        The fuzzer's process died; its last input is in `keep`.
    """
    if find_spec("atheris") is None:
        raise ArgumentError("--guided: atheris is not installed (the extra `fuzz`)")
    if not any(name in target.name for target in targets(data)):
        raise ArgumentError(f"--guided: no target's name holds {name!r}")
    place = keep / ".guided"
    for each in (place / _CORPUS, place / _INPUT):
        each.mkdir(parents=True, exist_ok=True)
    (place / _SUMMARY).unlink(missing_ok=True)
    # libFuzzer ends its process when it is done
    child = multiprocessing.get_context("spawn").Process(
        target=_fuzz, args=(data, name, inputs, seed, keep)
    )
    child.start()
    child.join()
    if not (place / _SUMMARY).is_file():
        raise GeometryError(f"the fuzzer's process died: its last input is in {place / _INPUT}")
    facts: dict[str, object] = json.loads((place / _SUMMARY).read_text(encoding="utf-8"))
    return facts


def _fuzz(data: Path | None, name: str, inputs: int, seed: int, keep: Path) -> None:
    import atheris

    for function in _functions():
        atheris.instrument_func(function)
    found = [target for target in targets(data) if name in target.name]
    choices = [(target, good) for target in found for good in target.seeds][:256]
    tallies = {target.name: Tally(target.name) for target in found}
    place = keep / ".guided"
    for k, (_, good) in enumerate(choices):
        content = bytes([k]) + good.files[good.main][:_LONGEST]
        (place / _CORPUS / f"seed-{k}").write_bytes(content)

    def one(content: bytes) -> None:
        target, good = choices[content[0] % len(choices) if content else 0]
        files = good.files | {good.main: content[1:]}
        judge(target, Seed(good.main, files), place / _INPUT, tallies[target.name])
        if sum(tally.inputs for tally in tallies.values()) >= inputs:
            for tally in tallies.values():
                save(keep, tally)
            (place / _SUMMARY).write_text(json.dumps(summary(list(tallies.values()))))
            os._exit(0)

    options = [f"-seed={seed}", f"-max_len={_LONGEST}", "-verbosity=0", "-mutate_depth=1"]
    corpus = str(place / _CORPUS)
    atheris.Setup(["fuzz", corpus, *options], one, custom_mutator=_mutated)
    atheris.Fuzz()


def _mutated(content: bytes, longest: int, seed: int) -> bytes:
    return (content[:1] + mutate(content[1:], random.Random(seed)))[:longest]


def _functions() -> Iterator[FunctionType]:
    """Functions of the readers' modules and of their classes; compiled ones are not seen."""
    for name, module in list(sys.modules.items()):
        if not name.startswith(_WATCHED):
            continue
        owners: list[Any] = [module]
        owners += [each for each in vars(module).values() if isinstance(each, type)]
        for owner in owners:
            for function in list(vars(owner).values()):
                if isinstance(function, FunctionType) and function.__module__ == name:
                    yield function
