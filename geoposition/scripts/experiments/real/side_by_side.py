"""Each chain's figures beside what was published or measured before, and what is attainable."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from geoposition.accuracy import NMAD_FACTOR
from geoposition.scripts.experiments.real.beside import Beside
from geoposition.scripts.experiments.real.pairs import Pair
from geoposition.scripts.experiments.real.sources import REUNION, VENTOUX
from geoposition.scripts.experiments.real.worldview import WorldView
from geoposition.scripts.report import number

VENDOR_PX: Final[Mapping[str, Mapping[str, tuple[float, float, float]]]] = {
    "wv1": {"row": (-0.01, 0.06, 0.13), "col": (0.00, 0.10, 0.18)},
    "wv2": {"row": (0.06, 0.07, 0.17), "col": (-0.03, 0.22, 0.38)},
}
"""Vendor's RPC less an independent program's model of the products: mean, std, largest."""
MATCHING_PX: Final = 0.1
"""What least-squares matching reaches of natural texture. *Source*: Gruen 1985, S. Afr. J. of
Photogrammetry, Remote Sensing and Cartography 14(3)."""
RESIDUAL_PX: Final = 0.5 * MATCHING_PX / NMAD_FACTOR
"""Median residual of a pair of such matches: half the size of a normal error in one image."""
SRTM_SIGMA_M: Final = 6.2 / 1.645
"""From 6.2 m at 90 % over Eurasia. *Source*: Rodríguez, Morris & Belz 2006, Photogrammetric
Engineering & Remote Sensing 72(3), table 1."""
_DRAWS: Final = 20_000

_BEFORE: Final[Mapping[str, Mapping[str, float]]] = {
    VENTOUX: {"matches": 465, "residual": 2.4, "bias_row": 0.6, "bias_col": 2.3},
    REUNION: {"matches": 3560, "residual": 0.36, "median": 0.03, "nmad": 0.52},
}
"""An independent program's SIFT matches and intersections with the RPCs as they are."""


def worldview_figures(found: WorldView) -> list[Beside]:
    """Figures of the WorldView pair."""
    facts, repeats = found.adjustment, found.repeats
    ratio, half = repeats.ratio
    reference = found.intersected["reference"].rmse_m
    left = np.array(list(found.left_arcsec.values()))
    sigma = np.array(found.sigma_arcsec).reshape(-1, 3)
    scatter = (
        f"one survey scatters about its prediction: in {len(repeats.rmse_m)} surveys with fresh "
        f"noise the errors are {number(ratio)} ± {number(half)} times as large as predicted. The "
        f"models as delivered, given the same marks, leave {number(reference, 3)} m: what remains "
        "is the marks' noise, no attitude."
    )
    turned = "found to the noise of control and marks; yaw only shows at the images' sides."
    return [
        Beside("check points before, RMSE in space", "m", found.intersected["before"].rmse_m,
               None, None, "the bias planted in the attitude, 8″ to 20″ from 770 km."),
        Beside("check points adjusted, RMSE in space", "m", found.intersected["after"].rmse_m,
               None, float(facts["predicted_check_rmse_m"]), scatter, 3),
        Beside("roll and pitch left, RMS", "″", _rms(left[:, :2]), None, _rms(sigma[:, :2]),
               turned, 4),
        Beside("yaw left, RMS", "″", _rms(left[:, 2]), None, _rms(sigma[:, 2]), turned, 2),
        *_vendor_figures(found),
    ]  # fmt: skip


def _vendor_figures(found: WorldView) -> list[Beside]:
    """Return the scatter of the vendor's RPC about the adjusted model, by image and axis."""
    out = []
    why = (
        "attitude motion, which depends on the row alone and which no RPC follows; attainable is "
        "the RPC fitted here to the same model. Errors of the adjusted attitude add "
        + ", ".join(f"{number(float(v), 2)}" for v in found.repeats.std_px.ravel())
        + " px in the square, and planted noise what remains."
    )
    for name, rpcs in found.rpcs.items():
        for axis in ("row", "col"):
            vendor, ours = getattr(rpcs.adjusted_vendor, axis), getattr(rpcs.adjusted_ours, axis)
            known = VENDOR_PX[name][axis][1]
            label = f"vendor's RPC less adjusted model, {name} {axis}, std"
            out.append(Beside(label, "px", vendor.std, known, ours.std, why, 3))
    return out


def expected_std_px(found: WorldView, image: int, axis: int) -> float:
    """Return the vendor's known scatter and that of repeated adjustments, in the square."""
    rpcs = list(found.rpcs.values())[image].reference_vendor
    known = (rpcs.row, rpcs.col)[axis].std
    return float(np.hypot(known, found.repeats.std_px[image, axis]))


def pair_figures(pair: Pair) -> list[Beside]:
    """Figures of an image pair."""
    summary: Any = pair.stereo.summary
    before = _BEFORE[pair.case.name]
    was = summary["residual_before_removal_px"]["median"]
    bias = np.abs(summary["relative_bias_px"][1]["residual"])
    figures = [
        Beside("matches", "", summary["intersected"], before["matches"], None,
               "features are looked for along the chord that the models give, so that weaker "
               "ones are told apart.", 0),
        Beside("rays miss each other as the RPCs are, median", "px", was, before["residual"],
               None, "the RPCs' relative bias, a property of the products."),
    ]  # fmt: skip
    figures += [
        Beside(f"relative bias, {axis}", "px", float(bias[k]), before[f"bias_{axis}"], None,
               "half the disagreement, in one image, across the epipolar lines.")
        for k, axis in enumerate(("row", "col")) if f"bias_{axis}" in before
    ]  # fmt: skip
    figures.append(
        Beside("rays miss each other without the bias, median", "px",
               summary["residual_px"]["median"], None, RESIDUAL_PX,
               f"attainable with matches of {MATCHING_PX:g} px; this is matching noise alone and "
               "says nothing of absolute accuracy.", 3)
    )  # fmt: skip
    coarse = pair.surface["comparison"]["reference_cells_m"] is not None
    return figures + (_coarse_figures(pair) if coarse else _fine_figures(pair))


def _coarse_figures(pair: Pair) -> list[Beside]:
    """Return the heights against a reference whose cells are much coarser than the surface's."""
    comparison = pair.surface["comparison"]
    cells, sparse = comparison["reference_cells_m"], _sparse(pair)
    count = cells["count"]
    low, high = nmad_interval_m(count, SRTM_SIGMA_M)
    name = pair.case.reference
    smooths = (
        f"{name}'s 90 m cells smooth a ravine away: within a cell the ground differs from its "
        "height by more than either is wrong."
    )
    return [
        Beside(f"points less {name}, NMAD", "m", sparse["nmad"], None, None, smooths, 1),
        Beside(f"surface less {name}, means of its cells, NMAD", "m", cells["nmad"], None,
               SRTM_SIGMA_M,
               f"attainable is {name}'s own error; an NMAD of {count} such errors lies between "
               f"{number(low, 1)} and {number(high, 1)} m in 95 of 100 cases.", 1),
        Beside(f"surface less {name}, means of its cells, median", "m", cells["median"], None,
               None, "no control: the pair's height is that of its RPCs, and of six cells.", 1,
               True),
    ]  # fmt: skip


def _fine_figures(pair: Pair) -> list[Beside]:
    """Return the heights against a reference as fine as the surface."""
    summary: Any = pair.stereo.summary
    before, sparse = _BEFORE[pair.case.name], _sparse(pair)
    comparison = pair.surface["comparison"]
    dense = comparison["difference_m"]
    own = "attainable is the deviation stated for our heights, were the reference exact; its own"
    shift = comparison["shift_enu_m"]
    moved = ""
    if shift is not None:
        north, rest = number(shift[1], 2), number(comparison["coregistered_m"]["nmad"], 2)
        moved = f" With the reference {north} m further north {rest} m are left."
    return [
        Beside("points less reference, median", "m", sparse["median"], before["median"], 0.0,
               "both follow the first image's RPC.", 2, True),
        Beside("points less reference, NMAD", "m", sparse["nmad"], before["nmad"],
               float(summary["sigma_enu_m"]["total"]["u"]),
               f"{own} noise comes on top. The earlier figure holds the relative bias.", 2),
        Beside("reference's cells that the surface has", "%",
               100.0 * comparison["reference_cover"], None, 100.0,
               "what one image hides from the other, and where the matches of the two tools "
               "disagree about themselves.", 1),
        Beside("surface less reference, median", "m", dense["median"], None, 0.0,
               "as for the points.", 2, True),
        Beside("surface less reference, NMAD", "m", dense["nmad"], None, pair.surface_sigma_m,
               f"{own} noise and its smoothing come on top.{moved}", 2),
    ]  # fmt: skip


def _sparse(pair: Pair) -> Mapping[str, Any]:
    summary: Any = pair.stereo.summary
    found: Mapping[str, Any] = summary["reference"]["difference_m"]
    return found


def nmad_interval_m(count: int, sigma_m: float) -> tuple[float, float]:
    """Return the 95 % interval of the NMAD of `count` normal errors, by a fixed simulation."""
    errors = np.random.default_rng(0).normal(0.0, sigma_m, (_DRAWS, count))
    off = np.abs(errors - np.median(errors, axis=1, keepdims=True))
    low, high = np.quantile(NMAD_FACTOR * np.median(off, axis=1), (0.025, 0.975))
    return float(low), float(high)


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
