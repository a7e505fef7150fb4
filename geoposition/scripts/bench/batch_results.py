"""What a batch has left behind, to be compared: files by content, events by scene."""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from pathlib import Path
from typing import Final

from geoposition.scripts.batch.manifest import NAME
from geoposition.scripts.batch.scene import MARK, STATE

_TIMES: Final = re.compile(
    rb'"(seconds|models|image|mpx_per_s)": [0-9.]+|\d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC'
)
"""What commands say of their own speed, and when: no two runs agree in that."""


def contents(output: Path) -> dict[str, str]:
    """Fingerprints of all results, but for the words about when and how fast they were made."""
    return {
        path.relative_to(output).as_posix(): hashlib.sha256(
            _TIMES.sub(b"", path.read_bytes())
        ).hexdigest()
        for path in sorted(output.rglob("*"))
        if path.is_file() and path.name not in (MARK, NAME) and STATE not in path.parts
    }


def events(output: Path) -> Counter[tuple[str, str]]:
    """Count what the journal says: how often each scene was begun, done, failed."""
    journal = output / STATE / "journal.jsonl"
    lines = journal.read_text(encoding="utf-8").splitlines() if journal.exists() else []
    return Counter((line["id"], line["event"]) for line in map(json.loads, lines))


def count_of(output: Path, event: str) -> int:
    """Count one kind of event over all scenes."""
    return sum(count for (_, kind), count in events(output).items() if kind == event)
