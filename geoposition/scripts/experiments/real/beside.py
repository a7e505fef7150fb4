"""A figure beside others: ours, the published one, the attainable bound, and why they differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from geoposition.scripts.report import Table, Text, number


@dataclass(frozen=True, slots=True)
class Beside:
    """One figure of ours with its `unit`; `published` and `bound` are None where there is none."""

    name: str
    unit: str
    ours: float
    published: float | None
    bound: float | None
    why: str
    digits: int = 2
    sign: bool = False

    def as_json(self) -> dict[str, Any]:
        """Return the figures and words by name."""
        facts = asdict(self)
        return {key: facts[key] for key in ("name", "unit", "ours", "published", "bound", "why")}

    def cells(self) -> tuple[str, ...]:
        """Return the cells of a table's row."""
        values = (self.ours, self.published, self.bound)
        shown = ("–" if v is None else number(v, self.digits, sign=self.sign) for v in values)
        return (self.name, self.unit, *shown)


def blocks_of(figures: Sequence[Beside], caption: str) -> list[Table | Text]:
    """Return the table of `figures`, and below it their reasons."""
    head = ("figure", "unit", "ours", "published", "attainable")
    reasons: dict[str, list[str]] = {}
    for figure in figures:
        reasons.setdefault(figure.why, []).append(figure.name)
    words = [Text(f"{_together(names)}: {why}") for why, names in reasons.items()]
    return [Table(caption, head, [f.cells() for f in figures], text_columns=2), *words]


def _together(names: Sequence[str]) -> str:
    """Return several figures' names as one: what stands before the comma where that is alike."""
    heads = {name.partition(",")[0] for name in names}
    return heads.pop() if len(names) > 1 and len(heads) == 1 else "; ".join(names)
