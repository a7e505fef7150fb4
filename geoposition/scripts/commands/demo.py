"""`geoposition demo`: a simulated three-line scene, end to end, with its report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geoposition.scripts.options import JsonOption


def command(
    out: Annotated[
        Path, typer.Option("-o", "--out", help="Folder to make; a former demo's is renewed.")
    ] = Path("geoposition-demo"),
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same scene.")] = 1,
    image_sigma: Annotated[
        float, typer.Option(help="Noise of the image points, pixels (one sigma).")
    ] = 0.3,
    json: JsonOption = False,
) -> None:
    """Simulate a three-line scene, intersect and locate its points, and report how good it is.

    Writes report.html, demo.json, the models, tie points, check points and DEM, ready for the
    other commands. Takes some ten seconds; the first run also compiles, a minute or two.

    Example: geoposition demo --out my-demo
    """
    import json as json_text
    import shlex
    import time

    from geoposition.errors import ArgumentError
    from geoposition.scripts.demo.data import DemoOptions
    from geoposition.scripts.demo.files import as_json, write_inputs
    from geoposition.scripts.demo.folder import MARK_FILE, check_folder, files_of, whole_folder
    from geoposition.scripts.demo.report import build_report
    from geoposition.scripts.demo.run import run_demo
    from geoposition.scripts.report import provenance, render
    from geoposition.scripts.results import plain, print_facts, print_json, progress_bar

    if not 0.001 <= image_sigma <= 100.0:
        raise ArgumentError(f"--image-sigma: 0.001 to 100 pixels expected, got {image_sigma:g}")
    check_folder(out)
    began = time.perf_counter()
    options = DemoOptions(seed=seed, image_sigma_px=image_sigma)
    with whole_folder(out) as folder:
        with progress_bar("simulating (a first run also compiles)", json) as progress:
            result = run_demo(options, folder / "dem.tif", progress)
        write_inputs(result, folder)
        facts = as_json(result)
        page = build_report(
            result,
            provenance(
                {
                    "command": f"geoposition demo --seed {seed} --image-sigma {image_sigma:g}",
                    "seed": seed,
                    "time and frames": "TAI; GCRS to ITRS with IAU 2006/2000A and the IERS tables",
                    "corrections": _corrections(options.scene.corrections.describe()),
                    "data": "simulated; no real image or telemetry is involved",
                }
            ),
            shlex.quote(str(out)),
        )
        (folder / "report.html").write_text(render(page), encoding="utf-8")
        facts["files"] = sorted([*files_of(folder), MARK_FILE])
        text = json_text.dumps(plain(facts), ensure_ascii=False, allow_nan=False, indent=1)
        (folder / MARK_FILE).write_text(text + "\n", encoding="utf-8")
    report = out / "report.html"
    seconds = round(time.perf_counter() - began, 1)
    if json:
        print_json(facts | {"out": str(out), "report": str(report), "seconds": seconds})
        return
    true, measured = result.true.statistics, result.measured.statistics
    print_facts(
        "A simulated three-line scene",
        {
            "check points": len(result.check.ids),
            "true models": _summary(true.e.rmse, true.n.rmse, true.u.rmse, true.rmse_3d_m),
            "measured models": _summary(
                measured.e.rmse, measured.n.rmse, measured.u.rmse, measured.rmse_3d_m
            ),
            "dense heights": f"{len(result.grid.ids)} points against the DEM",
            "time": f"{seconds} s",
            "report": str(report),
        },
    )


def _summary(e: float, n: float, u: float, space: float) -> str:
    return f"RMSE east {e:.2f}, north {n:.2f}, up {u:.2f}, in space {space:.2f} m"


def _corrections(described: dict[str, object]) -> str:
    names = [name.replace("_", " ") for name, value in described.items() if value]
    return ", ".join(names) or "none"
