"""Report pieces of an adjustment: what was rejected and found, what was planned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from geoposition.scripts.adjust.figures import layout_map
from geoposition.scripts.adjust.plan import Layout
from geoposition.scripts.report import Block, Image, Note, Table, Text, number

_MOST_ROWS: Final = 200


def rejected_blocks(facts: Mapping[str, Any]) -> list[Block]:
    """Say what the whole table looks like, and why each rejected point may be wrong."""
    blocks: list[Block] = []
    for finding in facts["diagnosis"]:
        blocks.append(
            Note(
                f"The control as a whole looks as if: {finding['message']}. So changed, its cost "
                f"would fall from {finding['cost']:.0f} to {finding['cost_mended']:.0f}. Nothing "
                "was changed."
            )
        )
    found = facts["rejections"]
    if not found:
        blocks.append(Text("No point was rejected."))
        return blocks
    rows = [
        (r["id"], r["role"], r["reason"], number(r["residual_px"], 2),
         number(r["statistic"], 1), number(r["limit"], 1))
        for r in found[:_MOST_ROWS]
    ]  # fmt: skip
    more = f" The first {_MOST_ROWS} of {len(found)}." if len(found) > _MOST_ROWS else ""
    blocks.append(
        Table(
            "Points rejected as blunders: the likely reason, the largest image residual in "
            f"pixels, and the test's chi-square beside its limit.{more}",
            ("point", "role", "reason", "residual", "chi-square", "limit"),
            rows,
            text_columns=3,
        )
    )
    return blocks


def plan_blocks(layout: Layout) -> list[Block]:
    """Where control helps most, as a table and a map."""
    rows = [
        (str(k + 1), number(float(np.degrees(p[0])), 6), number(float(np.degrees(p[1])), 6),
         number(float(p[2]), 1), number(float(error), 3))
        for k, (p, error) in enumerate(
            zip(layout.geodetic, layout.expected_rmse_m, strict=True)
        )
    ]  # fmt: skip
    return [
        Table(
            f"Control chosen from {layout.candidates} candidates, each the most useful beside "
            "those above it, and the RMSE in space expected over the common ground then, metres.",
            ("order", "longitude °", "latitude °", "height m", "expected RMSE"),
            rows,
        ),
        Image(layout_map(layout), "Where control helps most, in order, and how good it gets.",
              "A map of numbered points and a falling curve."),
    ]  # fmt: skip
