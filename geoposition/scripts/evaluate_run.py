"""An evaluation run: one scene or a list, matched, evaluated, reported, written."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from geoposition.calib_fields.evaluate import Evaluation, EvaluationOptions, evaluate
from geoposition.calib_fields.field import load_field
from geoposition.calib_fields.geometry import Dom
from geoposition.calib_fields.match import Cause, DomMatches, DomMatchOptions, match_dom
from geoposition.calib_fields.relative import RELATIVES
from geoposition.errors import ArgumentError, MissingFileError, ProductError
from geoposition.matching import ImageSource
from geoposition.product import Product
from geoposition.scripts.product_images import image_of
from geoposition.scripts.results import Progress, plain
from geoposition.scripts.tables import whole_file, write_points
from geoposition.sensors.readers import open_product
from geoposition.terrain import RasterTerrain

_HASHED_BYTES: Final = 64 * 2**20
"""Of larger files the checksum covers the first so many bytes, and says so."""
_SCENE_FACTS: Final = ("name", "date", "region", "side_swing_deg")


@dataclass(frozen=True, slots=True)
class Settings:
    """What a scene is evaluated with; `None` and empty are left to the run."""

    dom: tuple[Path, ...] = ()
    dem: tuple[Path, ...] = ()
    geoid: Path | None = None
    field: Path | None = None
    image: Path | None = None
    relative: str = "shift"
    reference_sigma_m: float | None = None
    search_m: float = 100.0
    window_px: int = 64
    spacing_px: int | None = None
    least_correlation: float = 0.4
    line_period_s: float | None = None
    dom_band: int | None = None

    def resolved(self) -> Settings:
        """Return it with what its field says put in where nothing else is given."""
        if self.field is None:
            if not self.dom or not self.dem:
                raise ArgumentError("evaluate: --dom and --dem expected, or --field")
            return self
        found = load_field(self.field)
        dom, dem = self.dom or found.dom, self.dem or found.dem
        if not dom or not dem:
            raise ProductError(self.field, "", "files of a dom and of a dem expected")
        sigma = self.reference_sigma_m
        return replace(
            self,
            dom=dom,
            dem=dem,
            geoid=self.geoid or (None if self.dem else found.geoid),
            reference_sigma_m=found.dom_sigma_m if sigma is None else sigma,
        )


@dataclass(frozen=True, slots=True, eq=False)
class SceneResult:
    """One scene: what is known of it, what went in, and what came out."""

    facts: Mapping[str, object]
    product: Product
    source: ImageSource
    dom: Dom
    settings: Settings
    terrain_facts: tuple[str, ...]
    evaluation: Evaluation


def run(path: Path, given: Settings, output: Path, progress: Progress) -> dict[str, object]:
    """Evaluate the product or the list at `path`, write into `output`; facts fit for JSON."""
    from geoposition.scripts.evaluate_report import build_report
    from geoposition.scripts.report import render

    scenes = _scenes(path, given)
    results = [_one(facts, product, own, progress) for facts, product, own in scenes]
    inputs = {str(name): _checksum(name) for name in _inputs(results)}
    summaries = [_summary(result) for result in results]
    summary: dict[str, object] = (
        summaries[0] if len(summaries) == 1 else {"scenes": summaries}
    ) | {"inputs": inputs}
    page = render(build_report(results, inputs))
    output.mkdir(parents=True, exist_ok=True)
    names = []
    for k, result in enumerate(results):
        name = "matches.gpkg" if len(results) == 1 else f"matches_{k + 1:02d}.gpkg"
        write_points(output / name, _columns(result.evaluation))
        names.append(name)
    summary["outputs"] = [str(output / name) for name in ("evaluation.json", "report.html", *names)]
    text = json.dumps(plain(summary), ensure_ascii=False, allow_nan=False, indent=1)
    for name, content in (("evaluation.json", text), ("report.html", page)):
        with whole_file(output / name) as temporary:
            temporary.write_text(content, encoding="utf-8")
    return summary


def _scenes(path: Path, given: Settings) -> list[tuple[dict[str, object], Path, Settings]]:
    """Facts, product and settings of each scene of a list; of a product, itself."""
    if path.suffix.lower() == ".toml" and path.is_file():
        try:
            root = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ProductError(path, "", f"TOML expected: {error}") from None
        if "scene" in root:
            return _listed(path, root, given)
    return [({"name": path.name}, path, given)]


def _listed(
    path: Path, root: Mapping[str, Any], given: Settings
) -> list[tuple[dict[str, object], Path, Settings]]:
    shared, listed = root.get("defaults", {}), root["scene"]
    if not isinstance(shared, dict) or not isinstance(listed, list) or not listed:
        raise ProductError(path, "scene", "[[scene]] tables and a table [defaults] expected")
    scenes = []
    for k, scene in enumerate(listed):
        place = f"scene {k + 1}"
        if not isinstance(scene, dict) or not isinstance(scene.get("product"), str):
            raise ProductError(path, place, "a table with a product expected")
        merged = shared | scene
        facts = {name: merged.pop(name) for name in _SCENE_FACTS if name in merged}
        product = path.parent / merged.pop("product")
        facts.setdefault("name", product.name)
        scenes.append((facts, product, _settings(path, place, merged, given)))
    return scenes


def _settings(path: Path, place: str, values: Mapping[str, Any], given: Settings) -> Settings:
    known = {field.name for field in fields(Settings)}
    changed: dict[str, Any] = {}
    for name, value in values.items():
        if name not in known:
            raise ProductError(path, f"{place}: {name}", "no such option")
        if name in ("dom", "dem"):
            several = [value] if isinstance(value, str) else value
            if not isinstance(several, list) or not all(isinstance(s, str) for s in several):
                raise ProductError(path, f"{place}: {name}", "a file name, or a list, expected")
            changed[name] = tuple(path.parent / item for item in several)
        elif name in ("geoid", "field", "image"):
            if not isinstance(value, str):
                raise ProductError(path, f"{place}: {name}", "a file name expected")
            changed[name] = path.parent / value
        else:
            wanted = str if name == "relative" else (int, float)
            if isinstance(value, bool) or not isinstance(value, wanted):
                raise ProductError(path, f"{place}: {name}", "another type of value expected")
            changed[name] = value
    return replace(given, **changed)


def _one(
    facts: Mapping[str, object], path: Path, settings: Settings, progress: Progress
) -> SceneResult:
    settings = settings.resolved()
    if settings.relative not in RELATIVES:
        raise ArgumentError(
            f"--relative: one of {', '.join(RELATIVES)} expected, got {settings.relative!r}"
        )
    matching = DomMatchOptions(
        window_px=settings.window_px,
        spacing_px=settings.spacing_px,
        search_m=settings.search_m,
        least_correlation=settings.least_correlation,
    )
    options = EvaluationOptions(
        relative=settings.relative,  # type: ignore[arg-type]
        reference_sigma_m=settings.reference_sigma_m or 0.0,
        line_period_s=settings.line_period_s,
    )
    product = open_product(path)
    source = image_of(product, settings.image)
    dom = Dom.open(settings.dom, settings.dom_band)
    terrain = RasterTerrain(settings.dem, settings.geoid)
    matches = match_dom(source, product.model, dom, terrain, matching, progress)
    evaluation = evaluate(matches, product.model, options)
    return SceneResult(facts, product, source, dom, settings, terrain.provenance, evaluation)


def _summary(result: SceneResult) -> dict[str, object]:
    found = result.evaluation
    return (
        dict(result.facts)
        | found.as_dict()
        | {
            "product": str(result.product.path),
            "image": str(result.source.path),
            "dom": [str(path) for path in result.dom.paths],
            "heights": list(result.terrain_facts),
            "coverage": coverage(found.matches),
            "pixel_m": found.matches.pixel_m,
            "ground_sample_m": list(found.matches.ground_sample_m),
            "window_px": found.matches.window_px,
            "spacing_px": found.matches.spacing_px,
        }
    )


def coverage(matches: DomMatches) -> float:
    """Share of the tiles of an 8 × 8 division of the overlap that hold a match."""
    known = np.isfinite(matches.model_px).all(axis=1)
    place = matches.model_px[known]
    low, size = place.min(axis=0), np.maximum(np.ptp(place, axis=0), 1.0)
    tile = np.minimum(((place - low) / size * 8.0).astype(np.int64), 7) @ np.array([8, 1])
    return len(np.unique(tile[matches.used[known]])) / len(np.unique(tile))


def _columns(evaluation: Evaluation) -> dict[str, Any]:
    """Every patch as a row, those that were lost with their cause."""
    m = evaluation.matches
    names = np.array([cause.name.lower() for cause in Cause])
    lon_lat = np.degrees(m.ground[:, :2])
    sigma = np.sqrt(np.diagonal(m.covariance_px2, axis1=1, axis2=2))
    sigma_m = np.sqrt(np.diagonal(m.covariance_m2, axis1=1, axis2=2))
    residual = np.full((len(m.cause), 2), np.nan)
    residual[m.used & np.isfinite(m.error_px).all(axis=1)] = evaluation.residual_px
    return {
        "id": np.arange(len(m.cause)).astype(str),
        "lon": lon_lat[:, 0],
        "lat": lon_lat[:, 1],
        "height": m.ground[:, 2],
        "row": m.image_px[:, 0],
        "col": m.image_px[:, 1],
        "model_row": m.model_px[:, 0],
        "model_col": m.model_px[:, 1],
        "error_row_px": m.error_px[:, 0],
        "error_col_px": m.error_px[:, 1],
        "residual_x_px": residual[:, 0],
        "residual_y_px": residual[:, 1],
        "sigma_row_px": sigma[:, 0],
        "sigma_col_px": sigma[:, 1],
        "shift_e_m": m.shift_en_m[:, 0],
        "shift_n_m": m.shift_en_m[:, 1],
        "sigma_e_m": sigma_m[:, 0],
        "sigma_n_m": sigma_m[:, 1],
        "correlation": m.correlation,
        "cause": names[m.cause],
    }


def _inputs(results: Sequence[SceneResult]) -> list[Path]:
    paths: dict[Path, None] = {}
    for result in results:
        settings = result.settings
        own = [result.product.path, result.source.path, *result.dom.paths, *settings.dem]
        for path in (*own, settings.geoid, settings.field):
            if path is not None:
                paths[path] = None
    return list(paths)


def _checksum(path: Path) -> str:
    if not path.is_file():
        return "a folder, or not a plain file"
    try:
        with path.open("rb") as file:
            head = file.read(_HASHED_BYTES)
    except OSError:
        raise MissingFileError(path, "", "readable file expected") from None
    size = path.stat().st_size
    note = "" if size <= _HASHED_BYTES else f" of the first {_HASHED_BYTES} of {size} bytes"
    return f"sha256 {hashlib.sha256(head).hexdigest()}{note}"
