"""Speed and memory of our own work, commit by commit: `asv run`.

The cases are those that `python -m geoposition.scripts.bench` sets beside the peers.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from geoposition.scripts.bench.history import HISTORY, USUAL, history_case
from geoposition.scripts.bench.machine import PeakMemory

_HELP = """
import contextlib, io
from geoposition.scripts.cli import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main(["--help"])
"""


class Work:
    """One call of each case, compiled before."""

    params = tuple(HISTORY)
    param_names = ("case",)
    timeout = 300.0
    number = 1
    warmup_time = 0.0
    sizes = USUAL

    def setup(self, key: str) -> None:
        """Make the scene; the first call compiles."""
        self._folder = TemporaryDirectory(prefix="geoposition_asv_")
        self._run = history_case(key, Path(self._folder.name), self.sizes).ours.run
        self._run()

    def teardown(self, key: str) -> None:
        """Remove the scene's files."""
        self._folder.cleanup()

    def time_call(self, key: str) -> None:
        """Wall time of a call."""
        self._run()

    def track_peak_memory(self, key: str) -> float:
        """Memory that a call needs beyond what was there, its result included; NaN if unknown."""
        with PeakMemory() as peak:
            self._run()
        return float("nan") if peak.bytes is None else peak.bytes

    track_peak_memory.unit = "bytes"  # type: ignore[attr-defined]


class Start:
    """Time until a new process can work."""

    def timeraw_import(self) -> str:
        """Import the package alone."""
        return "import geoposition"

    def timeraw_import_models(self) -> str:
        """Import the sensor models."""
        return "import geoposition.pushbroom"

    def timeraw_help(self) -> str:
        """Show the command line's help."""
        return _HELP
