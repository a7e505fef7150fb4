"""From [[unknown]] tables to blocks of unknowns; sensible ones where none are given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from geoposition.adjust import (
    Block,
    attitude_bias,
    attitude_process,
    attitude_spline,
    image_bias,
    look_angles,
    mounting,
    orbit,
    time_offset,
)
from geoposition.adjust.unknowns import (
    ARCSEC_RAD,
    ATTITUDE_SIGMA_RAD,
    IMAGE_SIGMA_PX,
    LOOK_SIGMA_RAD,
    ORBIT_SIGMA_M,
    TIME_SIGMA_S,
)
from geoposition.errors import ArgumentError, ProductError
from geoposition.scripts.adjust.images import RunImage
from geoposition.scripts.adjust.request import UnknownInput
from geoposition.scripts.adjust.schema import Node

_SHARED: Final = ("mounting", "look_angles", "attitude_process")
"""Kinds of which all images have one set, unless told otherwise."""


@dataclass(frozen=True, slots=True)
class Priors:
    """Standard deviations of biases where [[unknown]] gives none."""

    attitude_rad: float = ATTITUDE_SIGMA_RAD
    image_px: float = IMAGE_SIGMA_PX


TIES_ALONE: Final = Priors(10.0 * ARCSEC_RAD, 10.0)
"""Matches alone say next to nothing of the parallax: a wide prior would let noise move heights."""


@dataclass(frozen=True, slots=True)
class _Want:
    """One block to be made: name, images, and what the table says."""

    name: str
    images: tuple[int, ...]
    given: UnknownInput


def held_without_control(images: Sequence[RunImage]) -> tuple[RunImage, ...]:
    """Return the images with the first one fixed, if none is.

    Without control nothing tells where all images together are: the others follow the first.
    """
    if len(images) < 2 or any(image.fixed for image in images):
        return tuple(images)
    return (replace(images[0], fixed=True), *images[1:])


def blocks_of(
    images: Sequence[RunImage], unknowns: Sequence[UnknownInput], priors: Priors
) -> tuple[Block, ...]:
    """Blocks of unknowns; with no [[unknown]] at all, one bias for each image that is not fixed.

    A rigorous model gets a constant attitude bias, an RPC a shift of its image points.
    """
    if not unknowns:
        return tuple(_default(images, priors))
    blocks: list[Block] = []
    for given in unknowns:
        for want in _wanted(images, given):
            blocks.append(_block(images, want, priors))
    twice = [b.name for i, b in enumerate(blocks) if b.name in [o.name for o in blocks[:i]]]
    if twice:
        node = unknowns[-1].sigma
        raise ProductError(
            node.path, "[[unknown]]", f"each unknown once expected, {twice[0]} is there twice"
        )
    return tuple(blocks)


def _default(images: Sequence[RunImage], priors: Priors) -> list[Block]:
    models = [image.model for image in images]
    angle, shift = priors.attitude_rad, priors.image_px
    blocks = []
    for k, image in enumerate(images):
        if image.fixed:
            continue
        if image.is_rigorous:
            name = f"{image.id}.attitude_bias"
            blocks.append(attitude_bias(name, models, [k], sigma_rad=angle))
        else:
            blocks.append(image_bias(f"{image.id}.image_bias", [k], sigma_px=shift))
    return blocks


def _wanted(images: Sequence[RunImage], given: UnknownInput) -> list[_Want]:
    node = given.sigma
    if given.images is None:
        chosen = [
            k for k, image in enumerate(images)
            if not image.fixed and (image.is_rigorous or given.kind == "image_bias")
        ]  # fmt: skip
        if not chosen:
            node.refuse("kind", f"{given.kind} needs a rigorous model, there is none: image_bias?")
    else:
        ids = [image.id for image in images]
        chosen = []
        for name in given.images:
            if name not in ids and not (name.isdigit() and int(name) < len(ids)):
                node.refuse("images", f"one of {', '.join(ids)} expected, got {name!r}")
            chosen.append(ids.index(name) if name in ids else int(name))
        for k in chosen:
            if given.kind != "image_bias" and not images[k].is_rigorous:
                node.refuse(
                    "images", f"{given.kind} needs a rigorous model, {ids[k]} has none: image_bias?"
                )
    shared = given.kind in _SHARED if given.shared is None else given.shared
    if shared:
        joined = "+".join(images[k].id for k in chosen)
        return [_Want(given.name or f"{joined}.{given.kind}", tuple(chosen), given)]
    return [
        _Want(
            f"{images[k].id}.{given.kind}" if given.name is None or len(chosen) > 1
            else given.name,
            (k,), given,
        )
        for k in chosen
    ]  # fmt: skip


def _block(images: Sequence[RunImage], want: _Want, priors: Priors) -> Block:
    models = [image.model for image in images]
    given, node, name, on = want.given, want.given.sigma, want.name, list(want.images)
    degree = given.degree or 0
    knots = given.knots
    makers: dict[str, Callable[[], Block]] = {
        "attitude_bias": lambda: attitude_bias(
            name, models, on, degree=degree, sigma_rad=_angle(node, priors.attitude_rad)
        ),
        "attitude_spline": lambda: attitude_spline(
            name,
            models,
            on,
            knots_line=knots if isinstance(knots, tuple) else None,
            knots=knots if isinstance(knots, int) else 5,
            smooth=given.smooth,
            sigma_rad=_angle(node, priors.attitude_rad),
        ),
        "attitude_process": lambda: attitude_process(name, models, on, spacing_s=given.spacing_s),
        "mounting": lambda: mounting(name, on, sigma_rad=_angle(node, priors.attitude_rad)),
        "orbit": lambda: orbit(
            name,
            models,
            on,
            sigma_m=_sigma(node, "sigma_m", ORBIT_SIGMA_M),
            drift_sigma_m_s=node.numbers("drift_sigma_m_s", 3),
        ),
        "time_offset": lambda: time_offset(
            name, on, sigma_s=float(_sigma(node, "sigma_s", TIME_SIGMA_S)[0])
        ),
        "look_angles": lambda: look_angles(
            name,
            on,
            degree=2 if given.degree is None else given.degree,
            sigma_rad=float(_angle(node, LOOK_SIGMA_RAD)[0]),
        ),
        "image_bias": lambda: image_bias(
            name, on, degree=degree, sigma_px=float(_sigma(node, "sigma_px", priors.image_px)[0])
        ),
    }
    try:
        return makers[given.kind]()
    except ArgumentError as error:
        raise ProductError(node.path, node.place, str(error)) from None


def _angle(node: Node, default_rad: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return sigmas about three axes, rad: sigma_rad, or arcsec under the other names."""
    radians = node.numbers("sigma_rad", 3)
    if radians is not None:
        _only(node, "sigma_rad")
        return np.array(radians)
    return _sigma(node, "sigma_arcsec", default_rad / ARCSEC_RAD) * ARCSEC_RAD


def _sigma(node: Node, key: str, default: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the sigmas (3,) under `key` or sigma, in the kind's own unit."""
    _only(node, key)
    found = node.numbers(key, 3) or node.numbers("sigma", 3)
    return np.full(3, default) if found is None else np.array(found)


def _only(node: Node, key: str) -> None:
    """Refuse sigmas of another unit."""
    names = ("sigma", "sigma_arcsec", "sigma_rad", "sigma_m", "sigma_s", "sigma_px")
    strange = [name for name in names if node.has(name) and name not in (key, "sigma")]
    if strange:
        node.refuse(strange[0], f"{key} (or sigma, in the same unit) expected for this kind")
    if node.has(key) and node.has("sigma"):
        node.refuse("sigma", f"either sigma or {key} expected, not both")
