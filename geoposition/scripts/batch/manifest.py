"""The batch's manifest: every scene's state, tries, time and last failure, as of now."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from geoposition.scripts.batch.jobs import Job, Outcome
from geoposition.scripts.tables import whole_file

NAME: Final = "manifest.json"


@dataclass(slots=True)
class SceneState:
    """One scene so far: `status` is waiting, retrying, done, kept (done before) or failed.

    `window` where it is but a window of one; windows are told, not counted.
    """

    window: bool = False
    status: str = "waiting"
    tries: int = 0
    seconds: float = 0.0
    message: str = ""


@dataclass(slots=True)
class Manifest:
    """All scenes of a run; `write` brings it to disk, whole."""

    output: Path
    scenes: dict[str, SceneState] = field(default_factory=dict)

    @classmethod
    def of(cls, output: Path, jobs: Sequence[Job]) -> Manifest:
        """Return the manifest of `jobs` before the first of them ran."""
        windows = {part.id for job in jobs for part in job.after}
        return cls(output, {job.id: SceneState(job.id in windows) for job in jobs})

    def record(self, outcome: Outcome, final: bool) -> None:
        """Take in the outcome of one try."""
        scene = self.scenes[outcome.id]
        scene.tries += outcome.status != "kept"
        scene.seconds = outcome.seconds
        scene.message = outcome.message
        bad = outcome.status in ("failed", "lost")
        scene.status = ("failed" if final else "retrying") if bad else outcome.status

    def count(self, *statuses: str) -> int:
        """Scenes in one of `statuses`."""
        return sum(scene.status in statuses for scene in self.whole.values())

    @property
    def whole(self) -> dict[str, SceneState]:
        """The scenes themselves, without their windows."""
        return {name: scene for name, scene in self.scenes.items() if not scene.window}

    def facts(self) -> dict[str, object]:
        """Return counts and every scene's state, fit for JSON."""
        return {
            "scenes": len(self.whole),
            "done": self.count("done", "kept"),
            "kept": self.count("kept"),
            "failed": self.count("failed"),
            "output": str(self.output),
            "states": {
                name: {
                    "status": scene.status,
                    "tries": scene.tries,
                    "seconds": scene.seconds,
                    "message": scene.message,
                    "folder": str(self.output / name),
                }
                for name, scene in self.scenes.items()
            },
        }

    def write(self) -> None:
        """Write `manifest.json` into the output folder."""
        with whole_file(self.output / NAME) as part:
            part.write_text(json.dumps(self.facts(), indent=1), encoding="utf-8")
