"""What the real chains found, together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from geoposition.scripts.experiments.real.beside import Beside
from geoposition.scripts.experiments.real.pairs import Pair
from geoposition.scripts.experiments.real.side_by_side import pair_figures, worldview_figures
from geoposition.scripts.experiments.real.size import QUICK, Size
from geoposition.scripts.experiments.real.sources import WORLDVIEW
from geoposition.scripts.experiments.real.worldview import WorldView


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Results of the chains that ran, and a note for each that was skipped, by name."""

    seed: int
    size: Size
    worldview: WorldView | None
    pairs: tuple[Pair, ...]
    notes: Mapping[str, str]

    @property
    def chains(self) -> dict[str, WorldView | Pair]:
        """The chains that ran, by name."""
        first = {} if self.worldview is None else {WORLDVIEW: self.worldview}
        return {**first, **{pair.case.name: pair for pair in self.pairs}}

    @property
    def figures(self) -> dict[str, list[Beside]]:
        """Figures side by side, by chain."""
        first = {} if self.worldview is None else {WORLDVIEW: worldview_figures(self.worldview)}
        return first | {pair.case.name: pair_figures(pair) for pair in self.pairs}

    def as_json(self) -> dict[str, Any]:
        """All figures by name; the same for the same seed and files."""
        return {
            "experiment": "real",
            "seed": self.seed,
            "quick": self.size == QUICK,
            "chains": {name: chain.as_json() for name, chain in self.chains.items()},
            "side_by_side": {
                name: [figure.as_json() for figure in chain] for name, chain in self.figures.items()
            },
            "skipped": dict(self.notes),
        }
