"""The command line: `geoposition COMMAND ...`.

Errors are one line on stderr: exit 2 for bad usage or bad input, 1 for a defect of ours.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any

import typer

import geoposition
from geoposition.errors import GeopositionError
from geoposition.scripts.first_run import prepare

Callback = Callable[..., Any]

_HELP = "From push-broom images, ephemeris and attitude to ground positions of known accuracy."
_GROUPS = {
    "rpc": "Rational polynomial coefficients: fit, compare, convert.",
    "attitude": "Attitude from star sensors and gyros: check, fuse, convert, find jitter.",
    "experiment": "The seed documents' tables and real samples: ours, theirs and the bound.",
}
_HELP_OPTIONS = ("-h", "--help")

_COMMANDS = (
    "demo",
    "info",
    "locate",
    "project",
    "intersect",
    "adjust",
    "export",
    "reimage",
    "ortho",
    "dsm",
    "evaluate",
    "calibrate",
    "batch",
    "rpc_fit",
    "rpc_compare",
    "rpc_convert",
    "attitude_preprocess",
    "attitude_determine",
    "attitude_axis_angle",
    "attitude_gyro_check",
    "attitude_jitter",
    "attitude_convert",
    "attitude_fuse",
    "experiment_thesis_ch3",
    "experiment_intervals",
    "experiment_thesis_ch4",
    "experiment_thesis",
    "experiment_jitter",
    "experiment_real",
)


def _main(
    version: bool = typer.Option(False, "--version", help="Show the version and exit."),
) -> None:
    if version:
        typer.echo(geoposition.__version__)
        raise typer.Exit
    prepare(sys.argv[1:])


def command_words() -> frozenset[tuple[str, ...]]:
    """Return every command as the words one types."""
    return frozenset(_words_of(name) for name in _COMMANDS)


def _words_of(name: str) -> tuple[str, ...]:
    group, _, rest = name.partition("_")
    words = (group, rest) if group in _GROUPS else (name,)
    return tuple(word.replace("_", "-") for word in words)


def build(names: Iterable[str] = _COMMANDS) -> typer.Typer:
    """Return the application with the commands `names`, as their modules are called."""
    return _assembled({name: _callback(name) for name in names})


def _listing() -> typer.Typer:
    """Return the application as far as help shows it: what commands take is left out."""
    return _assembled({name: _stand_in(_callback(name)) for name in _COMMANDS})


def _for(arguments: Sequence[str]) -> typer.Typer:
    """Return what `arguments` need of the application: to read all signatures takes a while."""
    words = tuple(arguments)
    called = [name for name in _COMMANDS if words[: len(_words_of(name))] == _words_of(name)]
    if called:
        return build(called)
    if not words or words[-1] in (*_GROUPS, *_HELP_OPTIONS, "--version"):
        return _listing()
    return build()


def _assembled(callbacks: Mapping[str, Callback]) -> typer.Typer:
    app = typer.Typer(
        name="geoposition",
        help=_HELP,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": list(_HELP_OPTIONS)},
    )
    app.callback(invoke_without_command=True)(_main)
    groups = {name: typer.Typer(help=text, no_args_is_help=True) for name, text in _GROUPS.items()}
    for name, group in groups.items():
        app.add_typer(group, name=name)
    for name, callback in callbacks.items():
        *above, command = _words_of(name)
        target = groups[above[0]] if above else app
        target.command(command)(callback)
    return app


def _callback(name: str) -> Callback:
    callback: Callback = import_module(f"geoposition.scripts.commands.{name}").command
    return callback


def _stand_in(callback: Callback) -> Callback:
    def command() -> None:
        raise AssertionError("a listing was called")

    command.__doc__ = callback.__doc__
    return command


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit."""
    sys.exit(run(arguments))


def run(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    try:
        words = sys.argv[1:] if arguments is None else arguments
        command = typer.main.get_command(_for(words))
        result = command.main(args=words, prog_name="geoposition", standalone_mode=False)
        return int(result) if isinstance(result, int) else 0
    except typer.Exit as stop:
        return int(stop.exit_code)
    except (typer.Abort, KeyboardInterrupt):
        return _fail("interrupted", 130)
    except GeopositionError as error:
        _reraise_for_developers()
        return _fail(str(error), 2)
    except OSError as error:
        _reraise_for_developers()
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{error.strerror or error}", 2)
    except MemoryError:
        return _fail("not enough memory for this input", 2)
    except Exception as error:  # the last door: a user never sees a traceback
        return _usage_error(error) if hasattr(error, "format_message") else _defect(error)


def _usage_error(error: Exception) -> int:
    """Say what the command line's parser refused; its exceptions know how to word it."""
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError":
        print(context.get_help() if context else error, file=sys.stderr)
        return 2
    path = context.command_path.removeprefix("geoposition").strip() if context else ""
    where = f"{path}: " if path else ""
    return _fail(f"{where}{error.format_message()} (see --help)", 2)  # type: ignore[attr-defined]


def _defect(error: Exception) -> int:
    _reraise_for_developers()
    return _fail(
        f"internal error, please report it with the command you ran: "
        f"{type(error).__name__}: {error} (GEOPOSITION_TRACEBACK=1 shows where)",
        1,
    )


def _reraise_for_developers() -> None:
    if os.environ.get("GEOPOSITION_TRACEBACK"):
        raise  # what the caller is handling


def _fail(message: str, status: int) -> int:
    line = " ".join(message.split())
    print(f"geoposition: {line}", file=sys.stderr)
    return status


if __name__ == "__main__":
    main()
