"""The documentation's pages as steps: files to write, Python to run, commands to parse or run.

A fence with `title="name"` is a file. A comment `<!-- run -->` before a fence of commands asks
that they be run, not only parsed. `<!-- files: demo -->` or `<!-- files: name=folder ... -->`
says what must lie in the folder beforehand: the demo's scene, or folders of the real data.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"
_BLOCK = re.compile(
    r"^(?P<run><!-- run -->\n)?```(?P<language>\w+)(?P<options>[^\n]*)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
_FILES = re.compile(r"^<!-- files: (.*?) -->$", re.MULTILINE)
_TITLE = re.compile(r'title="([^"]+)"')


@dataclass(frozen=True)
class Block:
    """One fence: its language, the file it is, if any, and whether its commands are run."""

    language: str
    title: str | None
    runs: bool
    text: str
    line: int

    def commands(self) -> list[list[str]]:
        """Arguments of each `geoposition` command in a block of shell, continuations joined."""
        if self.language != "sh":
            return []
        lines = self.text.replace("\\\n", " ").splitlines()
        words = [shlex.split(line, comments=True) for line in lines]
        return [line[1:] for line in words if line and line[0] == "geoposition"]


def pages() -> list[str]:
    """All pages, relative to `docs`."""
    return sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))


def blocks(page: str) -> list[Block]:
    """Fences of a page in order."""
    text = (DOCS / page).read_text(encoding="utf-8")
    found = []
    for match in _BLOCK.finditer(text):
        title = _TITLE.search(match["options"])
        found.append(
            Block(
                match["language"],
                title[1] if title else None,
                bool(match["run"]),
                match["text"],
                text.count("\n", 0, match.start()) + 1,
            )
        )
    return found


def files(page: str) -> Mapping[str, str]:
    """Folders a page needs: name in the working folder -> `demo`, or a folder of the real data."""
    found = _FILES.search((DOCS / page).read_text(encoding="utf-8"))
    words = found[1].split() if found else []
    pairs = (word.partition("=") for word in words)
    return {name: folder or "demo" for name, _, folder in pairs}
