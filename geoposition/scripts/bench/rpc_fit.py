# mypy: disable-error-code="import-not-found,import-untyped"
"""RPCs fitted to the same samples of a model, inverse and direct: ours, rpcfit, plain numpy."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import ModuleType
from typing import Any, Final

import numpy as np

from geoposition.arrays import FloatArray
from geoposition.rpc.fit import fit_samples
from geoposition.rpc.fit_basis import monomials
from geoposition.rpc.fit_build import RpcFit
from geoposition.rpc.fit_grid import Normalisation, Samples, virtual_grid
from geoposition.scripts.bench.machine import installed
from geoposition.scripts.bench.measure import Case, Contender, Missing
from geoposition.sensor_model import SensorModel

NODES: Final = (100, 40, 8)
QUICK_NODES: Final = (20, 10, 5)
TARGET_MPOINT_S: Final = 0.032 / 0.06
"""32,000 points in 0.06 s."""

_VERSION = installed("rpcfit")
_PEER = f"rpcfit {_VERSION}" if _VERSION else "rpcfit"
_EVERY = slice(None)


def rpc_fit_case(model: SensorModel, name: str, nodes: tuple[int, int, int] = NODES) -> Case:
    """Fit to one grid of samples; results are the samples' places by each fitted RPC."""
    samples = virtual_grid(model, model.height_range_m, nodes)
    peers = _rpcfit(samples), _lstsq(samples, model.shape)
    return replace(own_fit_case(model, name, nodes), peers=peers)


def own_fit_case(model: SensorModel, name: str, nodes: tuple[int, int, int] = NODES) -> Case:
    """As `rpc_fit_case`, without peers."""
    samples = virtual_grid(model, model.height_range_m, nodes)
    image, ground = samples.image_px.T.copy(), samples.geodetic.T.copy()

    def run() -> RpcFit:
        return fit_samples(image, ground, shape=model.shape)

    def result(raw: Any) -> FloatArray:
        fit: RpcFit = raw
        return fit.model.ground_to_image(ground).image_px

    return Case(
        key="rpc-fit",
        title=f"RPC fit, inverse and direct, {name}",
        points=len(image),
        unit="px",
        tolerance=0.1,
        ours=Contender("geoposition", _EVERY, run, result),
        target_mpoint_s=TARGET_MPOINT_S,
        bytes_per_point=40,
    )


def _rpcfit(samples: Samples) -> Contender | Missing:
    try:
        # rpcm imports srtm4, a source of heights that has no wheels and is not used here
        if installed("srtm4") is None:
            sys.modules.setdefault("srtm4", ModuleType("srtm4"))
        from rpcfit.rpc_fit import calibrate_rpc
    except ImportError as error:
        return Missing(_PEER, f"not installed ({error})")
    image = np.ascontiguousarray(samples.image_px[::-1].T)
    ground = samples.geodetic.T * (np.degrees(1.0), np.degrees(1.0), 1.0)

    def run() -> Any:
        return calibrate_rpc(image, ground, orientation="projloc")

    def result(raw: Any) -> FloatArray:
        col, row = raw.projection(*ground.T)
        return np.stack([row, col], axis=-1)

    return Contender(_PEER, _EVERY, run, result)


def _lstsq(samples: Samples, shape: tuple[int, int]) -> Contender:
    """Fit the linear equations once, without weights or regularisation."""
    normal = Normalisation.of(samples, shape)
    image, ground = normal.image(samples), normal.ground(samples)

    def run() -> list[FloatArray]:
        found = []
        for variables, targets in (
            (ground, image),
            (np.stack([image[1], image[0], ground[2]]), ground[:2]),
        ):
            terms = monomials(variables).T
            for target in targets:
                rows = np.concatenate([terms, -target[:, None] * terms[:, 1:]], axis=1)
                found.append(np.linalg.lstsq(rows, target, rcond=None)[0])
        return found

    def result(raw: Any) -> FloatArray:
        terms = monomials(ground)
        places = [c[:20] @ terms / (1.0 + c[20:] @ terms[1:]) for c in raw[:2]]
        return np.stack(places, axis=-1) * normal.image_scale_px + normal.image_off_px

    return Contender("numpy lstsq", _EVERY, run, result, "one step, no regularisation")
