"""The page about the real chains: figures side by side, then each chain, then how to go on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from geoposition.scripts.experiments.real import figures
from geoposition.scripts.experiments.real.beside import blocks_of
from geoposition.scripts.experiments.real.outcome import Outcome
from geoposition.scripts.experiments.real.pairs import Pair
from geoposition.scripts.experiments.real.side_by_side import VENDOR_PX, expected_std_px
from geoposition.scripts.experiments.real.size import QUICK
from geoposition.scripts.experiments.real.sources import SOURCES, WORLDVIEW
from geoposition.scripts.experiments.real.worldview import STAGES, Rpcs, WorldView
from geoposition.scripts.report import (
    Block,
    Commands,
    Image,
    KeyFigure,
    Note,
    Report,
    Section,
    Table,
    Text,
    number,
    provenance,
)
from geoposition.scripts.stereo import figures as stereo_figures
from geoposition.scripts.stereo.sections import degrees_of, found_rows
from geoposition.scripts.surface_figures import surface_difference
from geoposition.terrain import RasterTerrain

_STAGE_WORDS: Mapping[str, str] = {
    "before": "working models, attitude spoilt",
    "after": "adjusted models",
    "reference": "models as delivered",
    "vendor": "vendor's RPCs",
}


def build(outcome: Outcome, paths: Mapping[str, Mapping[str, Path]], folder: Path) -> Report:
    """Put the page together; `paths` are the samples', `folder` has the chains' files."""
    sections = [Section("Side by side", _side_by_side(outcome))]
    if outcome.worldview is not None:
        sections.append(Section(SOURCES[WORLDVIEW].title, _worldview(outcome.worldview)))
    for pair in outcome.pairs:
        name = pair.case.name
        sections.append(Section(SOURCES[name].title, _pair(pair, paths[name], folder / name)))
    sections.append(Section("Enter or leave the chain anywhere", _commands(outcome)))
    origins = {name: SOURCES[name].origin for name in outcome.chains}
    return Report(
        "The real chains",
        "Public samples from product or image pair to adjusted model, points, surface and RPC, "
        "each step through a file that the other commands take. Ours beside what others "
        "published or measured before, and beside what the data allow at best.",
        _keys(outcome),
        sections,
        provenance({"experiment": "real", "seed": outcome.seed,
                    "size": "quick" if outcome.size == QUICK else "full", **origins}),
    )  # fmt: skip


def _keys(outcome: Outcome) -> list[KeyFigure]:
    keys = []
    if outcome.worldview is not None:
        facts = outcome.worldview.adjustment
        after, before = (outcome.worldview.intersected[k].rmse_m for k in ("after", "before"))
        predicted = number(float(facts["predicted_check_rmse_m"]), 2)
        keys.append(
            KeyFigure(number(after, 2), "m", "WorldView-2 check points",
                      f"{number(before, 0)} m before, predicted {predicted}")
        )  # fmt: skip
    for pair in outcome.pairs:
        sparse, dense = pair.as_json()["sparse"], pair.surface["comparison"]
        was, now = (sparse[k]["median"] for k in ("residual_before_removal_px", "residual_px"))
        name = SOURCES[pair.case.name].title.partition(":")[0]
        keys.append(
            KeyFigure(number(now, 3), "px", f"{name}: rays miss each other",
                      f"{number(was, 2)} with the RPCs as they are")
        )  # fmt: skip
        compared = dense["reference_cells_m"] or dense["difference_m"]
        keys.append(
            KeyFigure(number(compared["nmad"], 2), "m",
                      f"{name}: surface less {pair.case.reference}",
                      f"NMAD; median {number(compared['median'], 2, sign=True)} m")
        )  # fmt: skip
    return keys


def _side_by_side(outcome: Outcome) -> list[Block]:
    blocks: list[Block] = [
        Text(
            "Published is a figure of the data's maker, of the literature, or of an independent "
            "program run over the same files; attainable is what noise and reference allow, "
            "computed or cited below each table."
        )
    ]
    for name, chain in outcome.figures.items():
        blocks += blocks_of(chain, f"{SOURCES[name].title}.")
    blocks += [Note(f"{SOURCES[name].title}: {text}.") for name, text in outcome.notes.items()]
    return blocks


def _worldview(found: WorldView) -> list[Block]:
    points = found.points
    rows = [
        (
            _STAGE_WORDS[stage], *(number(part.rmse_enu_m[axis], 3) for axis in "enu"),
            number(part.rmse_m, 3), number(part.residual_px, 3),
        )
        for stage, part in found.intersected.items()
    ]  # fmt: skip
    return [
        Text(
            f"The models as delivered are kept out as reference. They say where {len(points.ids)} "
            f"points of the ground are and where both images show them: {len(points.control)} "
            f"become control, {len(points.check)} check, {len(points.ties)} are ties of unknown "
            "ground. The working models have a bias and noise planted in their attitude, control "
            "and marks have noise."
        ),
        Table(
            "Check points intersected with each kind of model, against the reference: RMSE in "
            "metres, and by how much the rays miss each other (median, px).",
            ("models", "east", "north", "up", "space", "rays"),
            rows,
            strong=(1,),
        ),
        Image(
            figures.check_errors(found),
            "Errors of the check points before and after, each panel with its own scale.",
            "Two fields of arrows",
        ),
        _vendor_table(found),
        Image(
            figures.vendor_profiles(found),
            "Vendor's RPC less rigorous model along the lines, mean over columns and heights: "
            "the adjusted models show what the delivered ones do. Shaded: mean and standard "
            "deviation as an independent program found them.",
            "Four profiles along the lines, two for each image.",
        ),
        Note(_row_words(found)),
    ]


def _vendor_table(found: WorldView) -> Table:
    rows = []
    for image, (name, rpcs) in enumerate(found.rpcs.items()):
        for k, axis in enumerate(("row", "col")):
            mean, std, largest = VENDOR_PX[name][axis]
            ours = _axis(rpcs, "adjusted_vendor", axis)
            rows.append(
                (
                    f"{name}, {axis}", *ours,
                    f"{number(mean, 2, sign=True)} / {number(std, 2)} / {number(largest, 2)}",
                    number(expected_std_px(found, image, k), 3),
                    _axis(rpcs, "adjusted_ours", axis)[1],
                    _axis(rpcs, "ours_vendor", axis)[1],
                )
            )  # fmt: skip
    return Table(
        "Vendor's RPC less adjusted model, pixels, beside the independent program's mean / std / "
        "largest with the model as delivered; the std expected from that and from the errors of "
        "repeated adjustments; and the std of the RPC fitted here to the adjusted model, and of "
        "the vendor's RPC less that one.",
        ("image, axis", "mean", "std", "largest", "before", "expected std", "our RPC",
         "vendor less ours"),
        rows,
    )  # fmt: skip


def _axis(rpcs: Rpcs, which: str, axis: str) -> tuple[str, str, str]:
    part = getattr(getattr(rpcs, which), axis)
    return number(part.mean, 3, sign=True), number(part.std, 3), number(part.max, 3)


def _row_words(found: WorldView) -> str:
    rests = [rpcs.as_json()["not_of_the_row_px"] for rpcs in found.rpcs.values()]
    most = max(value for rest in rests for value in rest.values())
    return (
        "With the models as delivered the differences depend on the row alone: about the mean of "
        f"their row they scatter by {number(most, 4)} px at most. That is motion of the satellite "
        "while it scanned, which telemetry and rigorous model hold and cubics do not."
    )


def _pair(pair: Pair, files: Mapping[str, Path], folder: Path) -> list[Block]:
    run = pair.stereo
    points = run.points.geodetic[found_rows(run)]
    maps = {}
    assert run.differences is not None
    off = run.differences.difference_m[found_rows(run)]
    maps[f"Less {pair.case.reference}"] = stereo_figures.gridded(degrees_of(run), off)
    comparison = pair.surface["comparison"]
    rows = [("points", _spread(run.differences.as_dict()["difference_m"]))]
    rows.append(("surface", _spread(comparison["difference_m"])))
    if comparison["coregistered_m"] is not None:
        rows.append(("surface, reference shifted to it", _spread(comparison["coregistered_m"])))
    if comparison["reference_cells_m"] is not None:
        rows.append(("surface, means of the reference's cells",
                     _spread(comparison["reference_cells_m"])))  # fmt: skip
    return [
        Table(
            f"Heights less those of {pair.case.reference} at the same place, metres.",
            ("heights", "count", "median", "NMAD", "RMSE"),
            [(name, *cells) for name, cells in rows],
        ),
        Image(
            stereo_figures.height_maps(stereo_figures.gridded(degrees_of(run), points[:, 2]), maps),
            "Heights of the matched points, means of cells, and their difference from the "
            "reference.",
            "Maps of heights and of differences",
        ),
        Image(
            surface_difference(
                folder / "dsm.tif",
                RasterTerrain(files["reference"], files.get("geoid")),
                pair.case.reference,
            ),
            "The surface, and its difference from the reference.",
            "Two maps: heights, and differences",
        ),
        Text(
            f"{100.0 * pair.surface['matched_share']:.0f} % of the first image's pixels were "
            "matched; the rest the second image does not show, or shows too differently."
        ),
    ]


def _spread(facts: object) -> tuple[str, ...]:
    assert isinstance(facts, Mapping)
    values = (number(facts["median"], 2, sign=True), number(facts["nmad"]), number(facts["rmse"]))
    return (str(facts["count"]), *values)


def _commands(outcome: Outcome) -> list[Block]:
    lines: list[tuple[str, str]] = []
    if outcome.worldview is not None:
        at = WORLDVIEW
        folder, ending = STAGES["after"]
        lines += [
            (f"geoposition adjust {at}/RUN.toml -o adjusted", "control and ties to models"),
            (
                f"geoposition intersect {at}/{folder}/wv1{ending} {at}/{folder}/wv2{ending} "
                f"--ties {at}/ties.csv --gcps {at}/reference.csv -o points.csv",
                "check points against the kept-out reference",
            ),
            (f"geoposition rpc fit {at}/adjusted/wv1.toml -o wv1.RPB", "an RPC of the result"),
            (
                f"geoposition rpc compare {at}/adjusted/wv1.toml {at}/vendor/wv1.RPB",
                "the vendor's RPC less the adjusted model",
            ),
        ]
    for pair in outcome.pairs:
        at = pair.case.name
        files = SOURCES[at].files
        left, right, *images = (
            f"SAMPLES/{files[key]}" for key in ("left", "right", "left_image", "right_image")
        )
        given = "".join(f" --image {path}" for path in images)
        first, second = (f"{at}/agreeing/{Path(p).stem}.RPB" for p in (left, right))
        grid = f" --geoid SAMPLES/{files['geoid']}" if "geoid" in files else ""
        cell = "" if pair.case.cell_m is None else f" --resolution {pair.case.cell_m:g}"
        lines += [
            (
                f"geoposition intersect {left} {right} --ties {at}/ties.csv --remove-bias "
                f"-o points.csv --report stereo.html",
                "matches to points",
            ),
            (
                f"geoposition dsm {first} {second}{given} --ties {at}/ties.csv{cell} "
                f"--reference SAMPLES/{files['reference']}{grid} -o dsm.tif",
                "RPCs without their relative bias to the surface",
            ),
        ]
    return [
        Text("Run in the experiment's folder; SAMPLES is the folder of the public samples."),
        Commands(lines),
    ]
