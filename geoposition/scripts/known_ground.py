"""A product over known ground: its image, the reference under it, and their matches."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import rasterio
from rasterio.errors import RasterioError

from geoposition.calib_fields.dom import Dom
from geoposition.calib_fields.match import DomMatches, DomMatchOptions, match_dom
from geoposition.errors import GeometryError, ProductError
from geoposition.matching import ImageSource
from geoposition.product import Product
from geoposition.scripts.evaluate.settings import Settings
from geoposition.scripts.product_images import image_of
from geoposition.scripts.results import Progress
from geoposition.sensors.readers import open_product
from geoposition.sensors.readers.camera_file import read_camera_file
from geoposition.terrain import RasterTerrain

_ORTHOMETRIC: Final = re.compile(
    r"egm(?:96|_?2008|08)|orthometric|geoid|above.?mean.?sea|\bmsl\b|navd_?88"
    r"|srtm|[ns]\d\d[ew]\d{3}\.(?:hgt|dt[012])|copernicus_?dsm|\bcop(?:30|90)|astgtm|aw3d30"
    r"|nasadem",
    re.IGNORECASE,
)
"""Words in names and tags that only DEMs with heights above a geoid carry."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchedScene:
    """A product, its image, the reference, and the matches of the two."""

    product: Product
    source: ImageSource
    dom: Dom
    terrain: RasterTerrain
    settings: Settings
    matches: DomMatches

    @property
    def inputs(self) -> list[Path]:
        """Files that went in, each once."""
        s = self.settings
        own = [self.product.path, self.source.path, *self.dom.paths, *s.dem]
        own += [path for path in (s.geoid, s.field, s.camera, s.points) if path is not None]
        return list(dict.fromkeys(own))


def matched_scene(path: Path, settings: Settings, progress: Progress) -> MatchedScene:
    """Open the product at `path` and match its image; `settings` are resolved."""
    options = DomMatchOptions(
        window_px=settings.window_px,
        spacing_px=settings.spacing_px,
        search_m=settings.search_m,
        least_correlation=settings.least_correlation,
    )
    product = open_product(path)
    if settings.camera is not None:
        model = read_camera_file(settings.camera).applied_to(product.model)
        product = replace(product, model=model)
    source = image_of(product, settings.image)
    dom = Dom.open(settings.dom, settings.dom_band)
    terrain = ellipsoidal_terrain(settings)
    try:
        matches = match_dom(source, product.model, dom, terrain, options, progress)
    except GeometryError as error:
        if not str(error).startswith("terrain"):
            raise GeometryError(f"{product.path}: {error}") from None
        # the terrain does not know which file its lattice came from
        expected = f"a DEM with heights where the image is expected ({error})"
        raise ProductError(settings.dem[0], "coordinate system", expected) from None
    return MatchedScene(product, source, dom, terrain, settings, matches)


def ellipsoidal_terrain(settings: Settings) -> RasterTerrain:
    """DEM of the settings; heights that are above a geoid, without one named, are refused.

    What counts is the raster's own vertical datum; where it states none, a name or a tag that
    only DEMs above a geoid have.
    """
    terrain = RasterTerrain(settings.dem, settings.geoid)
    silent = any("states no vertical datum" in fact for fact in terrain.provenance)
    if settings.geoid is None and silent:
        for path in settings.dem:
            found = _ORTHOMETRIC.search(f"{path.name} {_tags(path)}")
            if found:
                raise ProductError(
                    path,
                    "vertical datum",
                    f"{found.group(0)!r} says that its heights are above a geoid: name the grid "
                    "with --geoid (or give the raster an ellipsoidal system such as EPSG:4979)",
                )
    return terrain


def _tags(path: Path) -> str:
    try:
        with rasterio.open(path) as file:
            texts = [*file.tags().values(), *(text for text in file.descriptions if text)]
    except RasterioError:
        return ""
    return " ".join(texts)
