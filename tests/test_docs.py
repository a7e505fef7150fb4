"""The documentation is true: its code runs, its commands exist, its pages build."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from doc_pages import DOCS, Block, blocks, files, pages

from geoposition.calib_fields.field import load_field
from geoposition.scripts import cli
from geoposition.scripts.batch.plan import read_plan
from geoposition.scripts.demo.data import DemoOptions
from geoposition.scripts.demo.files import write_inputs
from geoposition.scripts.demo.run import run_demo
from geoposition.scripts.evaluate.settings import Settings, scenes_of

ROOT = DOCS.parent
ALL = [(page, block) for page in pages() for block in blocks(page)]


def runs(block: Block) -> bool:
    return block.language == "python" or block.runs


RUNNING = sorted({page for page, block in ALL if runs(block)})


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo's inputs, of a smaller demo: same names, same columns, fewer points."""
    folder = tmp_path_factory.mktemp("demo")
    options = DemoOptions(check_points=60, grid=12)
    write_inputs(run_demo(options, folder / "dem.tif", lambda done, total: None), folder)
    return folder


@pytest.mark.parametrize("page", RUNNING)
def test_page_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """Every file is written, every Python block runs, every marked command succeeds, in order."""
    for name, folder in files(page).items():
        source: Path = request.getfixturevalue("demo" if folder == "demo" else "real_data")
        (tmp_path / name).symlink_to(source if folder == "demo" else source / folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    known: dict[str, object] = {"__name__": "docs"}
    for block in blocks(page):
        if block.title:
            Path(block.title).write_text(block.text, encoding="utf-8")
        elif block.language == "python":
            code = "\n" * block.line + block.text
            exec(compile(code, str(DOCS / page), "exec"), known)
        elif block.runs:
            for arguments in block.commands():
                assert cli.run(arguments) == 0, f"{page}: geoposition {' '.join(arguments)}"


def test_every_command_is_known() -> None:
    """What is not run is at least parsed: the command exists, and takes these arguments."""
    root = typer.main.get_command(cli.build())
    refused = [
        f"{page}:{block.line}: {' '.join(arguments)}: {reason}"
        for page, block in ALL
        for arguments in block.commands()
        if (reason := refusal(root, arguments))
    ]
    assert refused == []
    assert sum(len(block.commands()) for _, block in ALL) > 50


def refusal(root: Any, arguments: list[str]) -> str:
    """Why the command line would not take `arguments`; empty if it would."""
    command, rest = root, arguments
    while hasattr(command, "commands") and rest and not rest[0].startswith("-"):
        if rest[0] not in command.commands:
            return f"no command {rest[0]}"
        command, rest = command.commands[rest[0]], rest[1:]
    if "--help" in rest:
        return ""
    try:
        command.make_context("geoposition", list(rest))
    except typer.Exit:
        return ""
    except Exception as error:  # the parser's own, named differently by its versions
        return f"{type(error).__name__}: {error}"
    return ""


def test_batch_plans_are_plans(tmp_path: Path, demo: Path) -> None:
    """The batch of the guide finds its scenes, and each of its steps is a command."""
    (tmp_path / "geoposition-demo").symlink_to(demo)
    plans = [block for _, block in ALL if block.title == "batch.toml"]
    assert plans
    root = typer.main.get_command(cli.build())
    for block in plans:
        (tmp_path / "batch.toml").write_text(block.text, encoding="utf-8")
        plan = read_plan(tmp_path / "batch.toml", cli.command_words())
        assert len(plan.jobs) == 2
        for job in plan.jobs:
            for _, arguments in job.commands:
                assert refusal(root, list(arguments)) == ""


def test_every_command_has_its_place() -> None:
    """No command without a word in the guides or the table of reproductions."""
    text = "\n".join((DOCS / page).read_text(encoding="utf-8") for page in pages())
    absent = [
        words for words in cli.command_words() if f"geoposition {' '.join(words)}" not in text
    ]
    assert absent == []


def test_fields_and_lists_are_read(tmp_path: Path) -> None:
    """The accuracy guide's field and its list of scenes are what `evaluate` takes."""
    named = {block.title: block.text for _, block in ALL if block.title}
    for name in ("scenes.toml", "field.toml"):
        (tmp_path / name).write_text(named[name], encoding="utf-8")
    (tmp_path / "dom").mkdir()
    for name in ("dom/tile.tif", "dem.tif", "egm96_15.gtx", "gcps.csv"):
        (tmp_path / name).touch()
    field = load_field(tmp_path / "field.toml")
    assert (field.dom_sigma_m, field.dem_sigma_m) == (0.5, 1.0)
    first, second = scenes_of(tmp_path / "scenes.toml", Settings())
    assert first.facts["side_swing_deg"] == -4.965
    assert second.settings.dom == (tmp_path / "field" / "dom.tif",)


def test_named_modules_exist() -> None:
    """Modules that theory and reference name are there to be looked up."""
    absent = []
    for page in pages():
        text = (DOCS / page).read_text(encoding="utf-8")
        named = re.findall(r"`(geoposition(?:\.\w+)+)`", text)
        named += re.findall(r"^::: (geoposition(?:\.\w+)*)", text, re.MULTILINE)
        absent += [(page, name) for name in named if not exists(name)]
    assert absent == []


def exists(name: str) -> bool:
    """Whether `name` is a module, or something in one."""
    module, _, attribute = name.rpartition(".")
    try:
        if importlib.util.find_spec(name) is not None:
            return True
    except ModuleNotFoundError:
        pass
    return hasattr(importlib.import_module(module), attribute)


def test_every_page_is_in_the_navigation() -> None:
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    assert sorted(re.findall(r"[\w/-]+\.md", nav)) == pages()


def test_pages_build(tmp_path: Path) -> None:
    needed = ("mkdocs", "mkdocstrings", "material")
    if any(importlib.util.find_spec(name) is None for name in needed):
        pytest.skip("MKDOCS ABSENT: pip install '.[docs]' to build the pages")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
