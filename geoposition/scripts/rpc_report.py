"""The HTML page about one RPC fit: how well it follows, where, and what it cannot follow."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from geoposition.rpc.fit_check import FitCheck, Misfit
from geoposition.scripts.figures import COLOURS, SIGNED_MAP, STYLE, png
from geoposition.scripts.report import (
    Block,
    Image,
    KeyFigure,
    Note,
    Report,
    Section,
    Table,
    Text,
    provenance,
    render,
)
from geoposition.scripts.rpc_sources import SourceFit
from geoposition.scripts.tables import whole_file


def write(
    path: Path, product: str, output: str, fit: SourceFit, result: Mapping[str, object]
) -> None:
    """Write the page about `fit`, whole or not at all."""
    page = render(build(product, output, fit, result))
    with whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def build(product: str, output: str, fit: SourceFit, result: Mapping[str, object]) -> Report:
    """Put the page's pieces together."""
    check = fit.fit.check
    rows, cols, where = _independent(fit)
    keys = [
        KeyFigure(_small(max(rows.max, cols.max)), "px", "largest misfit", where),
        KeyFigure(_small(rows.rms), "px", "rms, rows"),
        KeyFigure(_small(cols.rms), "px", "rms, columns"),
    ]
    verified: Any = result.get("verified")
    if verified is not None:
        keys.append(
            KeyFigure(_small(verified["max_px"]), "px", "read again", f"by {verified['reader']}")
        )
    sections = [Section("Fit", _fit_blocks(fit, rows, cols, where))]
    if check is not None:
        sections += [
            Section("Misfit over the image", _map_blocks(check)),
            Section("Along the lines", _profile_blocks(check)),
        ]
    sections.append(Section("Coefficients", _coefficient_blocks(fit)))
    return Report(
        title=f"RPC of {Path(product).name}",
        summary=(
            f"Fitted to the {fit.source}; the RPC is in {Path(output).name}. It holds for "
            f"{fit.fit.region.statement()}; outside, nothing was checked."
        ),
        key_figures=keys,
        sections=sections,
        provenance=provenance({"product": product, "RPC": output}),
    )


def _independent(fit: SourceFit) -> tuple[Misfit, Misfit, str]:
    """Misfit at points that the fit has not seen, and what they are."""
    check = fit.fit.check
    if check is not None:
        return check.row, check.col, "between the nodes, and at other heights"
    for name, words in (
        ("kept_out", "at nodes kept out of a first fit"),
        ("leave_one_out", "at each point, fitted without it"),
    ):
        found: Any = fit.facts.get(name)
        if found is not None:
            return Misfit(**found["row"]), Misfit(**found["col"]), words
    rms = fit.fit.rms_px
    return Misfit(0.0, rms[0], rms[0]), Misfit(0.0, rms[1], rms[1]), "at the points themselves"


def _fit_blocks(fit: SourceFit, rows: Misfit, cols: Misfit, where: str) -> list[Block]:
    found = fit.fit
    table = [
        ["independent points", *_cells(rows, cols)],
        ["points of the fit, rms", _small(found.rms_px[0]), _small(found.rms_px[1]), "", ""],
    ]
    if found.check is not None and found.check.direct is not None:
        table.append(["direct, then inverse", *_cells(*found.check.direct)])
    blocks: list[Block] = [
        Text(f"{found.points} points; misfit is RPC − model, {where}."),
        Table(
            "Misfit, pixels",
            ["", "rows, rms", "columns, rms", "rows, max", "columns, max"],
            table,
            strong=(0,),
        ),
    ]
    blocks += [Note(words) for words in found.warnings]
    return blocks


def _map_blocks(check: FitCheck) -> list[Block]:
    return [
        Image(
            _maps(check),
            "Misfit of rows and columns over the image, mean of all heights of the check grid, "
            "pixels.",
            "Two maps of the misfit over the image",
        ),
        Image(
            _by_height(check),
            "Largest and rms misfit at each height of the check grid, pixels.",
            "Misfit against height",
        ),
    ]


def _profile_blocks(check: FitCheck) -> list[Block]:
    motion = check.profile_px - check.profile_px.mean(axis=0)
    rms = np.sqrt(np.mean(motion**2, axis=0))
    return [
        Text(
            "Mean misfit of single lines at middle height. What changes from line to line is "
            "attitude motion, which no RPC can follow: "
            f"{_small(rms[0])} px rms in rows, {_small(rms[1])} px in columns."
        ),
        Image(
            _profile(check),
            "Misfit line by line, pixels, against the image row.",
            "Two curves of misfit against the image row",
        ),
    ]


def _coefficient_blocks(fit: SourceFit) -> list[Block]:
    model, found = fit.model, fit.fit
    sigma = np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2), 0.0))
    names = ("line_num", "line_den", "samp_num", "samp_den")
    rows = []
    for k in range(20):
        cells = [str(k + 1)]
        for n, name in enumerate(names):
            if n % 2 == 0:
                error = sigma[n // 2, k]
            else:
                error = sigma[n // 2, 19 + k] if k else 0.0
            cells += [f"{getattr(model, name)[k]:.6e}", f"{error:.0e}"]
        rows.append(cells)
    used = " and ".join(f"{value:.1f}" for value in found.effective)
    blocks: list[Block] = [
        Text(
            f"The points determine {used} of 39 parameters of rows and columns; the others are "
            "damped towards zero. Beside each coefficient its standard deviation, with the "
            "misfit taken as independent errors."
        ),
        Table(
            "Coefficients in RPC00B order",
            ["", *(cell for name in names for cell in (name.replace("_", " "), "σ"))],
            rows,
        ),
    ]
    if found.check is not None:
        low, high = found.check.den_range[:, 0].min(), found.check.den_range[:, 1].max()
        blocks.append(
            Note(
                f"Denominators are free of zeros: on the check grid they stay within {low:.4f} "
                f"and {high:.4f} of their mean."
            )
        )
    return blocks


def _cells(rows: Misfit, cols: Misfit) -> list[str]:
    return [_small(rows.rms), _small(cols.rms), _small(rows.max), _small(cols.max)]


def _small(value: float) -> str:
    """Two digits that count, whatever the size."""
    return f"{value:.2g}" if value == 0.0 or abs(value) >= 1e-3 else f"{value:.1e}"


def _limit(values: Any) -> float:
    return max(float(np.nanmax(np.abs(values))), 1e-12)


def _maps(check: FitCheck) -> bytes:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 3.6), layout="constrained")
        both = figure.subplots(1, 2, sharey=True)
        mean = np.nanmean(check.difference_px, axis=0)
        for k, (axes, title) in enumerate(zip(both, ("Rows", "Columns"), strict=True)):
            limit = _limit(mean[..., k])
            image = axes.pcolormesh(
                check.samp_px, check.line_px, mean[..., k], cmap=SIGNED_MAP,
                norm=Normalize(-limit, limit), shading="nearest", rasterized=True,
            )  # fmt: skip
            axes.set_title(title)
            axes.set_xlabel("image column, px")
            axes.locator_params(axis="x", nbins=5)
            bar = figure.colorbar(image, ax=axes, location="bottom", pad=0.02, aspect=30)
            bar.locator = MaxNLocator(5)
            bar.set_label("px")
        both[0].set_ylabel("image row, px")
        both[0].invert_yaxis()
        return png(figure)


def _by_height(check: FitCheck) -> bytes:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 2.4), layout="constrained")
        axes = figure.add_subplot()
        size = np.abs(check.difference_px)
        for k, name in enumerate(("rows", "columns")):
            largest = np.nanmax(size[..., k], axis=(1, 2))
            rms = np.sqrt(np.nanmean(size[..., k] ** 2, axis=(1, 2)))
            axes.plot(
                check.height_m, largest, "o-", color=COLOURS[k], lw=1.2, ms=3, label=f"{name}, max"
            )
            axes.plot(check.height_m, rms, "--", color=COLOURS[k], lw=1.0, label=f"{name}, rms")
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("ellipsoidal height, m")
        axes.set_ylabel("px")
        figure.legend(loc="outside lower center", ncols=4)
        return png(figure)


def _profile(check: FitCheck) -> bytes:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.8, 2.9), layout="constrained")
        both = figure.subplots(2, 1, sharex=True)
        for k, (axes, name) in enumerate(zip(both, ("rows", "columns"), strict=True)):
            axes.axhline(0.0, color="#999999", lw=0.6)
            axes.plot(check.profile_line_px, check.profile_px[:, k], color=COLOURS[k], lw=0.8)
            axes.set_ylabel(f"{name}, px")
            axes.margins(x=0.0)
        both[-1].set_xlabel("image row, px")
        return png(figure)
