"""The fuzzing campaign: its seeds are right, and a short one finds nothing."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
import rasterio

from geoposition.calib_fields.field import load_field
from geoposition.errors import GeopositionError, ProductError
from geoposition.scripts.control_files import read_control_file
from geoposition.scripts.fuzz.campaign import Tally, feed, judge
from geoposition.scripts.fuzz.mutations import MUTATIONS, Mutation, mutate
from geoposition.scripts.fuzz.targets import Seed, Target, targets
from geoposition.sensors.readers.dimap_files import volume_images
from geoposition.terrain import RasterTerrain
from geoposition.xmlfile import read_xml

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


# What campaigns found ------------------------------------------------------------------------

LONG = "A" * 300


def test_a_file_named_beyond_what_systems_take_is_not_there(tmp_path: Path) -> None:
    field = tmp_path / "field.toml"
    field.write_text(f'[dem]\nfiles = ["{LONG}.tif"]\n')
    with pytest.raises(GeopositionError, match="no such file"):
        load_field(field)
    volume = tmp_path / "VOL_PHR.XML"
    volume.write_text(
        "<Dimap_Document><Dataset_Content><Dataset_Components><Component>"
        f'<COMPONENT_PATH href="DIM_{LONG}.XML"/>'
        "</Component></Dataset_Components></Dataset_Content></Dimap_Document>"
    )
    with pytest.raises(GeopositionError, match="none of its images is there"):
        volume_images(read_xml(volume))


def test_names_of_attributes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "gcps.geojson"
    path.write_bytes(
        b'{"type":"FeatureCollection","features":[{"type":"Feature","properties":'
        b'{"id":"g0","pro\xec\xbf\x13\xfa":1},"geometry":'
        b'{"type":"Point","coordinates":[5.0,44.0,300.0]}}]}'
    )
    with pytest.raises(ProductError, match="UTF-8"):
        read_control_file(path)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_lattice_of_heights_begins_somewhere(tmp_path: Path, bad: float) -> None:
    path = tmp_path / "dem.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=8, height=8, count=1, dtype="float32",
        crs="EPSG:4326", transform=rasterio.Affine(1e-3, 0.0, bad, 0.0, -1e-3, 45.0),
    ) as file:  # fmt: skip
        file.write(np.ones((1, 8, 8), dtype=np.float32))
    with pytest.raises(ProductError, match="geotransform: finite"):
        RasterTerrain(path)
