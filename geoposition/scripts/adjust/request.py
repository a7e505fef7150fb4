"""What is asked of an adjustment run, as read from its RUN.toml."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from geoposition.scripts.adjust.schema import Node

FAMILY_RISK: Final = 1e-4


@dataclass(frozen=True, slots=True)
class ImageInput:
    """One image: `rpc` is False, True for the product's own, or the path to one."""

    id: str
    product: Path
    rpc: bool | Path
    pixels: Path | None
    fixed: bool


@dataclass(frozen=True, slots=True)
class PointsInput:
    """Where ground points come from, and how good they are."""

    file: Path
    image_points: Path | None
    sigma_m: tuple[float, ...]
    image_sigma_px: float
    crs: str | None
    geoid: Path | None
    dem: Path | None
    dem_geoid: Path | None


@dataclass(frozen=True, slots=True)
class TiesInput:
    """Tables or matches, or matching of the images; `images` are those of a nameless match."""

    files: tuple[Path, ...]
    match: bool
    sigma_px: float
    images: tuple[str, ...] | None


@dataclass(frozen=True, slots=True)
class CheckInput:
    """Which points are kept out: a file of their own, ids, each n-th, or a share."""

    file: Path | None = None
    image_points: Path | None = None
    ids: tuple[str, ...] = ()
    every: int | None = None
    fraction: float | None = None
    leave_one_out: bool | None = None


@dataclass(frozen=True, slots=True)
class UnknownInput:
    """One [[unknown]]: its kind, the images by name (None: all that can), and its options."""

    kind: str
    name: str | None
    images: tuple[str, ...] | None
    shared: bool | None
    degree: int | None
    knots: int | tuple[float, ...] | None
    smooth: bool
    spacing_s: float
    sigma: Node

    @property
    def place(self) -> str:
        """Where it stands, for messages."""
        return self.sigma.place


@dataclass(frozen=True, slots=True)
class HeightsInput:
    """A DEM that gives tie points their heights."""

    dem: Path
    geoid: Path | None
    sigma_m: float


@dataclass(frozen=True, slots=True)
class RobustInput:
    """How blunders are looked for."""

    enabled: bool = True
    family_risk: float = FAMILY_RISK
    adapt: bool = True


@dataclass(frozen=True, slots=True)
class PlanInput:
    """How many control points to place, among which, and how good they will be."""

    count: int
    candidates: int | Path
    height_m: float | None
    sigma_m: tuple[float, ...]
    image_sigma_px: float


@dataclass(frozen=True, slots=True)
class OutputInput:
    """What is written beside the figures."""

    rpc: bool = False
    csm: bool = True
    models: bool = True
    report: bool = True


@dataclass(frozen=True, slots=True)
class RunInput:
    """A whole RUN.toml."""

    path: Path
    images: tuple[ImageInput, ...]
    control: PointsInput | None
    ties: TiesInput | None
    check: CheckInput
    unknowns: tuple[UnknownInput, ...]
    heights: HeightsInput | None
    robust: RobustInput
    plan: PlanInput | None
    output: OutputInput

    @property
    def control_file(self) -> Path | None:
        """The file of the control points."""
        return None if self.control is None else self.control.file

    def files(self) -> list[Path]:
        """All files it names."""
        found: list[Path | None] = [self.path]
        for image in self.images:
            found += [image.product, image.rpc if isinstance(image.rpc, Path) else None]
            found.append(image.pixels)
        if self.control is not None:
            c = self.control
            found += [c.file, c.image_points, c.geoid, c.dem, c.dem_geoid]
        found += [self.check.file, self.check.image_points]
        if self.ties is not None:
            found += list(self.ties.files)
        if self.heights is not None:
            found += [self.heights.dem, self.heights.geoid]
        return list(dict.fromkeys(path for path in found if path is not None))
