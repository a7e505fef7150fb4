"""The fuzzing campaign: its seeds are right, and a short one finds nothing."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from geoposition.errors import GeopositionError
from geoposition.scripts.fuzz.campaign import Tally, feed, judge
from geoposition.scripts.fuzz.mutations import MUTATIONS, Mutation, mutate
from geoposition.scripts.fuzz.targets import Seed, Target, targets

TARGETS = targets(None)
SHORT = 60


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_seeds_are_read_and_mutations_of_them_too_or_refused(
    target: Target, tmp_path: Path
) -> None:
    tally = Tally(target.name)
    for seed in target.seeds:
        judge(target, seed, tmp_path, tally)
    assert tally.read == len(target.seeds), tally.findings
    rng = random.Random(f"test {target.name}")
    for _ in range(SHORT):
        feed(target, rng, tmp_path, tally)
    assert tally.findings == []
    assert tally.refused > 0


def _defective(path: Path) -> None:
    content = path.read_bytes()
    if content == b"crash":
        raise KeyError("tag")
    if content == b"long":
        raise GeopositionError("one line\nand another")
    if content == b"refuse":
        raise GeopositionError("not this")
    if content == b"hang":
        while True:
            pass


@pytest.mark.parametrize(
    ("content", "kind"),
    [(b"crash", "traceback"), (b"long", "not one line"), (b"hang", "hang")],
)
def test_defects_are_found(
    content: bytes, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("geoposition.scripts.fuzz.campaign.HANG_S", 0.2)
    tally = Tally("defective")
    target = Target("defective", _defective, ())
    for each in (content, b"refuse", b"fine"):
        judge(target, Seed("a", {"a": each}), tmp_path, tally)
    assert [found[0] for found in tally.findings] == [kind]
    assert (tally.read, tally.refused) == (1, 1)


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.__name__)
def test_mutations_take_any_file(mutation: Mutation) -> None:
    rng = random.Random(3)
    for content in (b"", b"\n", b"<a b='1'>2</a>", b"t,x\n1,2\n3,4\n", bytes(range(256))):
        for _ in range(20):
            assert isinstance(mutation(content, rng), bytes)


def test_mutations_repeat_with_the_seed() -> None:
    content = b"<a><b>1.5</b><c>2</c></a>"
    rng, again = random.Random(7), random.Random(7)
    found = [mutate(content, rng) for _ in range(50)]
    assert found == [mutate(content, again) for _ in range(50)]
    assert len(set(found)) > 25
