"""What a scene over known ground is matched and evaluated with; lists of scenes in a RUN.toml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

from geoposition.calib_fields.field import load_field
from geoposition.errors import ArgumentError, ProductError
from geoposition.tomlfile import read_toml

SCENE_FACTS: Final = ("name", "date", "region", "side_swing_deg")
"""Keys of a scene in a list that are told in the report and change nothing."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What a scene is evaluated with; `None` and empty are left to the run.

    `camera` is a camera file put in the place of the product's own. `points` is a table of
    intersected points, such as `intersect` writes, whose heights are compared with the DEM.
    """

    dom: tuple[Path, ...] = ()
    dem: tuple[Path, ...] = ()
    geoid: Path | None = None
    field: Path | None = None
    image: Path | None = None
    camera: Path | None = None
    points: Path | None = None
    relative: str = "shift"
    reference_sigma_m: float | None = None
    height_sigma_m: float | None = None
    search_m: float = 100.0
    window_px: int = 64
    spacing_px: int | None = None
    least_correlation: float = 0.4
    line_period_s: float | None = None
    dom_band: int | None = None

    def resolved(self, command: str = "evaluate") -> Settings:
        """Return it with what its field says put in where nothing else is given."""
        if self.field is None:
            if not self.dom or not self.dem:
                raise ArgumentError(f"{command}: --dom and --dem expected, or --field")
            return self
        found = load_field(self.field)
        dom, dem = self.dom or found.dom, self.dem or found.dem
        if not dom or not dem:
            raise ProductError(self.field, "", "files of a dom and of a dem expected")
        sigma, height = self.reference_sigma_m, self.height_sigma_m
        return replace(
            self,
            dom=dom,
            dem=dem,
            geoid=self.geoid or (None if self.dem else found.geoid),
            reference_sigma_m=found.dom_sigma_m if sigma is None else sigma,
            height_sigma_m=found.dem_sigma_m if height is None else height,
        )


@dataclass(frozen=True, slots=True)
class ListedScene:
    """A scene of a run: facts for the report, the product, its settings, and its role."""

    facts: Mapping[str, object]
    product: Path
    settings: Settings
    hold_out: bool = False


def scenes_of(path: Path, given: Settings) -> list[ListedScene]:
    """Scenes of a list; of a product, itself."""
    if path.suffix.lower() == ".toml" and path.is_file():
        root = read_toml(path).data
        if "scene" in root:
            return _listed(path, root, given)
    return [ListedScene({"name": path.name}, path, given)]


def _listed(path: Path, root: Mapping[str, Any], given: Settings) -> list[ListedScene]:
    shared, listed = root.get("defaults", {}), root["scene"]
    if not isinstance(shared, dict) or not isinstance(listed, list) or not listed:
        raise ProductError(path, "scene", "[[scene]] tables and a table [defaults] expected")
    unknown = sorted(set(root) - {"defaults", "scene"})
    if unknown:
        raise ProductError(path, unknown[0], "no such table; [defaults] and [[scene]] are known")
    scenes = []
    for k, scene in enumerate(listed):
        place = f"scene {k + 1}"
        if not isinstance(scene, dict) or not isinstance(scene.get("product"), str):
            raise ProductError(path, place, "a table with a product expected")
        merged = shared | scene
        facts = {name: merged.pop(name) for name in SCENE_FACTS if name in merged}
        product = path.parent / merged.pop("product")
        facts.setdefault("name", product.name)
        hold_out = merged.pop("hold_out", False)
        if not isinstance(hold_out, bool):
            raise ProductError(path, f"{place}: hold_out", "true or false expected")
        scenes.append(ListedScene(facts, product, _settings(path, place, merged, given), hold_out))
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
        elif name in ("geoid", "field", "image", "camera", "points"):
            if not isinstance(value, str):
                raise ProductError(path, f"{place}: {name}", "a file name expected")
            changed[name] = path.parent / value
        else:
            wanted = str if name == "relative" else (int, float)
            if isinstance(value, bool) or not isinstance(value, wanted):
                raise ProductError(path, f"{place}: {name}", "another type of value expected")
            changed[name] = value
    return replace(given, **changed)
