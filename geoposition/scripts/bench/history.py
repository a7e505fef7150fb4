"""Our own work alone, case by case, for a history of its speed over the commits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from geoposition.scripts.bench import cases, remap, rpc_fit, scenes
from geoposition.scripts.bench.adjustment import problem
from geoposition.scripts.bench.adjustment_cases import adjustment_case
from geoposition.scripts.bench.cases import PairWork
from geoposition.scripts.bench.fusion import hour_case
from geoposition.scripts.bench.measure import Case
from geoposition.scripts.bench.scenes import RigorousScene, RpcScene
from geoposition.scripts.bench.work import RigorousWork, RpcWork


@dataclass(frozen=True, slots=True)
class HistorySizes:
    """Points of location, the side of an image, matches of an adjustment, seconds of telemetry.

    `fit_nodes` are the grid's of an RPC fit: lines, samples, heights.
    """

    points: int
    side_px: int
    matches: int
    span_s: float
    fit_nodes: tuple[int, int, int]


USUAL: Final = HistorySizes(200_000, 2048, 5_000, 600.0, rpc_fit.NODES)
TINY: Final = HistorySizes(500, 128, 60, 20.0, rpc_fit.QUICK_NODES)


def _rigorous(sizes: HistorySizes) -> RigorousWork:
    scene = RigorousScene("synthetic", scenes.synthetic_model(), real=False)
    return cases.rigorous_work(scene, sizes.points)


def _on_dem(folder: Path, sizes: HistorySizes) -> Case:
    work = _rigorous(sizes)
    return cases.on_dem(work, scenes.write_terrain(folder / "dem.tif", work.geodetic, 0.05))


def _rpc(folder: Path, sizes: HistorySizes) -> tuple[RpcWork, RpcScene]:
    scene = scenes.rpc_scene(None, folder)
    return cases.rpc_work(scene, sizes.points), scene


def _pair(folder: Path, sizes: HistorySizes) -> PairWork:
    work, scene = _rpc(folder, sizes)
    return cases.pair_work(scene, work)


def _fit(folder: Path, sizes: HistorySizes) -> Case:
    scene = scenes.rpc_scene(None, folder)
    return rpc_fit.own_fit_case(scene.left, scene.name, sizes.fit_nodes)


HISTORY: Final[dict[str, Callable[[Path, HistorySizes], Case]]] = {
    "direct": lambda folder, sizes: cases.direct(_rigorous(sizes)),
    "inverse": lambda folder, sizes: cases.inverse(_rigorous(sizes)),
    "dem": _on_dem,
    "rpc-project": lambda folder, sizes: cases.rpc_project(_rpc(folder, sizes)[0], "synthetic"),
    "rpc-locate": lambda folder, sizes: cases.rpc_locate(_rpc(folder, sizes)[0], "synthetic"),
    "rpc-dem": lambda folder, sizes: cases.rpc_on_dem(*_rpc(folder, sizes)),
    "rpc-fit": _fit,
    "pair-rays": lambda folder, sizes: cases.pair_rays(_pair(folder, sizes)),
    "pair-covariance": lambda folder, sizes: cases.pair_covariance(_pair(folder, sizes)),
    "adjust": lambda folder, sizes: adjustment_case("adjust", problem(sizes.matches), None),
    "fusion-hour-6": lambda folder, sizes: hour_case("bias", sizes.span_s),
    "remap-cubic": lambda folder, sizes: remap.remap(remap.remap_work(sizes.side_px), "cubic"),
    "reimage-cubic": lambda folder, sizes: remap.reimage(remap.remap_work(sizes.side_px), "cubic"),
}
"""What makes each case; its files, if any, go to the folder."""


def history_case(key: str, folder: Path, sizes: HistorySizes = USUAL) -> Case:
    """Make one of `HISTORY` on made-up scenes, which are the same everywhere."""
    return HISTORY[key](folder, sizes)
