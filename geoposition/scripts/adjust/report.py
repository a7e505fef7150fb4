"""The HTML page about one adjustment: what was corrected, how good it is, what was left out."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from geoposition.adjust.unknowns import ARCSEC_RAD
from geoposition.scripts.adjust.figures import correlations, image_vectors
from geoposition.scripts.adjust.ground import ground_blocks
from geoposition.scripts.adjust.plan import Layout
from geoposition.scripts.adjust.request import RunInput
from geoposition.scripts.adjust.sections import plan_blocks, rejected_blocks
from geoposition.scripts.adjust.solve import RunResult
from geoposition.scripts.report import (
    Block,
    Image,
    KeyFigure,
    Note,
    Report,
    Section,
    Table,
    number,
    provenance,
    render,
)

_MOST_IMAGES: Final = 6
_MOST_ROWS: Final = 200
_HASHED_BYTES: Final = 64 * 2**20


def page(
    request: RunInput,
    result: RunResult | None,
    layout: Layout | None,
    facts: Mapping[str, Any],
) -> str:
    """HTML of the run."""
    sections = []
    if result is not None:
        sections += [
            Section("Images", _images(facts)),
            Section("Control and check points", ground_blocks(result, facts)),
            Section("Image residuals", _image_residuals(result, facts)),
            Section("Unknowns", _unknowns(result, facts)),
            Section("Rejected points and findings", rejected_blocks(facts)),
        ]
    if layout is not None:
        sections.append(Section("Planning", plan_blocks(layout)))
    names = ", ".join(image.id for image in request.images)
    return render(
        Report(
            title=f"Adjustment of {names}",
            summary=_summary(facts) if result is not None else "Control planned, nothing adjusted.",
            key_figures=_keys(facts) if result is not None else (),
            sections=sections,
            provenance=provenance({"run": str(request.path)} | _checksums(request)),
        )
    )


def _summary(facts: Mapping[str, Any]) -> str:
    parts = []
    for role, word in (("control", "control"), ("check", "check")):
        if facts[f"{role}_rmse_m"] is not None:
            before = facts[f"{role}_rmse_before_m"]
            was = "" if before is None else f" ({number(before, 2)} m before)"
            parts.append(f"{number(facts[f'{role}_rmse_m'], 3)} m at {word} points{was}")
    space = f"The RMSE in space is {', '.join(parts)}. " if parts else ""
    out = len(facts["rejected"])
    told = {0: "No point was rejected as a blunder.", 1: "One point was rejected as a blunder."}
    weak = len(facts["weak"])
    rest = (
        f" {weak} combinations of unknowns rest on their priors." if weak > 1
        else " One combination of unknowns rests on its prior." if weak else ""
    )  # fmt: skip
    return (
        f"{len(facts['parameters'])} unknowns of {len(facts['images'])} images were estimated; "
        f"residuals are {number(facts['sigma0'], 2)} times as large as stated (sigma0). {space}"
        f"{told.get(out, f'{out} points were rejected as blunders.')}{rest}"
    )


def _keys(facts: Mapping[str, Any]) -> list[KeyFigure]:
    keys = []
    if facts["check_rmse_m"] is not None:
        predicted = facts["predicted_check_rmse_m"]
        remark = "" if predicted is None else f"predicted {number(predicted, 3)} m"
        keys.append(
            KeyFigure(number(facts["check_rmse_m"], 3), "m", "RMSE at check points", remark)
        )
    if facts["control_rmse_m"] is not None:
        used = facts["control"]["used"]
        label, remark = "RMSE at control points", f"{used} of {facts['control']['points']} used"
        keys.append(KeyFigure(number(facts["control_rmse_m"], 3), "m", label, remark))
    relative = facts["relative"]
    if relative is not None and "residual_px" in relative["after"]:
        was = relative["before"].get("residual_px", {}).get("median", float("nan"))
        keys.append(
            KeyFigure(number(relative["after"]["residual_px"]["median"], 3), "px",
                      "rays miss each other by, median", f"{number(was, 3)} px before")
        )  # fmt: skip
    remark = f"{number(facts['redundancy'], 0)} redundant equations"
    keys.append(KeyFigure(number(facts["sigma0"], 2), "", "sigma0", remark))
    return keys


def _images(facts: Mapping[str, Any]) -> list[Block]:
    rows = [
        (
            image["id"], image["sensor"], image["model"], "held" if image["held"] else "adjusted",
            *(number(image["change_px"][axis], 3, sign=True) for axis in ("row", "col")),
        )
        for image in facts["images"]
    ]  # fmt: skip
    blocks: list[Block] = [
        Table(
            "How far adjusting moved the image points of the same ground, mean over the image, "
            "pixels.",
            ("image", "sensor", "model", "", "row", "col"),
            rows,
            text_columns=4,
        )
    ]
    relative = facts["relative"]
    if relative is not None:
        blocks.append(_bias_table(facts, relative))
    return blocks


def _bias_table(facts: Mapping[str, Any], relative: Mapping[str, Any]) -> Table:
    ids = [image["id"] for image in facts["images"]]
    after = {b["product"]: b for b in relative["after"].get("bias_px", [])}
    rows = []
    for was in relative["before"].get("bias_px", []):
        now = after.get(was["product"], {"row": np.nan, "col": np.nan})
        cells = (was["row"], was["col"], now["row"], now["col"])
        rows.append((ids[was["product"]], *(number(float(v), 3, sign=True) for v in cells)))
    return Table(
        "Relative bias: the constant disagreement of each image with the others, as the matches "
        "show it across the epipolar lines, pixels.",
        ("image", "row before", "col before", "row after", "col after"),
        rows,
    )


def _image_residuals(result: RunResult, facts: Mapping[str, Any]) -> list[Block]:
    rows = []
    for image in facts["images"]:
        for role, spread in image["residual_px"].items():
            cells = []
            for when in ("before", "after"):
                found = spread[when]
                cells += ["–"] * 3 if found is None else [
                    number(found["rms"]["row"], 3), number(found["rms"]["col"], 3),
                    number(found["median"], 3),
                ]  # fmt: skip
            rows.append((image["id"], role, *cells))
    blocks: list[Block] = [
        Table(
            "Residuals, observed less projected, pixels: RMS of row and col, median size.",
            ("image", "points", "row before", "col before", "median before", "row after",
             "col after", "median after"),
            rows,
            text_columns=2,
        )
    ]  # fmt: skip
    done = result.adjustment
    known = (
        "Control and check points against their given positions",
        (done.control, done.check),
    )
    matched = ("Ties against their intersections", (done.ties,))
    for k, image in enumerate(result.images[:_MOST_IMAGES]):
        for words, sets in (known, matched):
            png = image_vectors(sets, k, image.id)
            if png is None:
                continue
            blocks.append(
                Image(
                    png,
                    f"Residuals in {image.id} before and after, magnified: the key arrow at the "
                    f"top of each panel gives its scale in pixels. {words}.",
                    f"Two panels of arrows over the image {image.id}: residuals before and after.",
                )
            )
    return blocks


def _unknowns(result: RunResult, facts: Mapping[str, Any]) -> list[Block]:
    rows = []
    for entry in facts["parameters"][:_MOST_ROWS]:
        angle = "value_arcsec" in entry
        factor = 1.0 / ARCSEC_RAD if angle else 1.0
        unit = "″" if angle else entry["unit"]
        rows.append(
            (
                entry["name"], f"{entry['value'] * factor:+.5g}".replace("-", "−"),
                f"{entry['sigma'] * factor:.2g}", f"{entry['prior_sigma'] * factor:.3g}", unit,
                f"{100.0 * entry['gain']:.1f}",
            )
        )  # fmt: skip
    blocks: list[Block] = [
        Table(
            "Unknowns with their standard deviations before (prior) and after, and the share of "
            "the prior variance that the measurements took away, %. Attitude is roll, pitch, yaw "
            "about the body's axes; image biases are observed less model.",
            ("unknown", "value", "sigma", "prior sigma", "unit", "determined"),
            rows,
        )
    ]
    if facts["weak"]:
        blocks.append(
            Note(
                "Not determined by these measurements, so left where the priors put it: "
                + "; ".join(weak["text"] for weak in facts["weak"][:10])
                + ". More control, or fewer unknowns, would settle it."
            )
        )
    if facts["correlated"]:
        pairs = ", ".join(
            f"{c['names'][0]} and {c['names'][1]} ({number(c['correlation'], 3, sign=True)})"
            for c in facts["correlated"][:12]
        )
        blocks.append(
            Note(f"Strongly correlated: {pairs}. Their sum is known better than each alone.")
        )
    png = correlations(result.adjustment)
    if png is not None:
        blocks.append(
            Image(png, "Correlations of the unknowns after adjusting.",
                  "A square of colours, one row and column for each unknown.")
        )  # fmt: skip
    return blocks


def _checksums(request: RunInput) -> dict[str, str]:
    out: dict[str, str] = {}
    for path in request.files():
        if path.is_file():
            with path.open("rb") as file:
                digest = hashlib.sha256(file.read(_HASHED_BYTES)).hexdigest()
            note = "" if path.stat().st_size <= _HASHED_BYTES else " (of the first 64 MiB)"
            out[_name(path, out)] = f"sha256 {digest}{note}"
    return out


def _name(path: Path, taken: Mapping[str, str]) -> str:
    return path.name if path.name not in taken else str(path)
