"""What the command line needs of itself: all for nobody, a listing for help, one for a call."""

from __future__ import annotations

from typing import Any

import pytest
import typer

from geoposition.scripts import cli


def helps(command: Any) -> dict[str, Any]:
    """Help of every command below `command`, by name."""
    below = getattr(command, "commands", None)
    return command.help if below is None else {name: helps(c) for name, c in below.items()}


def test_the_listing_shows_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    whole, listing = (typer.main.get_command(app) for app in (cli.build(), cli._listing()))
    assert helps(listing) == helps(whole)
    assert cli.run(["--help"]) == 0
    out = capsys.readouterr().out
    for words in cli.command_words():
        assert f" {words[0]} " in out


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["rpc"], 2, "convert"),
        (["rpc", "--help"], 0, "convert"),
        (["rpc", "fit", "--help"], 0, "--report"),
        (["lcoate", "x"], 2, "Did you mean 'locate'?"),
        (["rpc", "fot", "x"], 2, "Did you mean 'fit'?"),
        (["locate"], 2, "Missing argument"),
        (["--version"], 0, "."),
        ([], 2, "locate"),
    ],
)
def test_each_way_to_call_it(
    arguments: list[str], status: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(arguments) == status
    told = capsys.readouterr()
    assert said in told.out + told.err
