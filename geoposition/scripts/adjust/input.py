"""RUN.toml: what is to be adjusted, with what, and what is to be written."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from geoposition.errors import MissingFileError, ProductError
from geoposition.scripts.adjust.keys import (
    CHECK,
    CONTROL,
    DEGREES,
    HEIGHTS,
    IMAGE,
    KINDS,
    OUTPUT,
    PLAN,
    ROBUST,
    TIES,
    UNKNOWN,
)
from geoposition.scripts.adjust.request import (
    FAMILY_RISK,
    CheckInput,
    HeightsInput,
    ImageInput,
    OutputInput,
    PlanInput,
    PointsInput,
    RobustInput,
    RunInput,
    TiesInput,
    UnknownInput,
)
from geoposition.scripts.adjust.schema import TABLES, Node
from geoposition.tomlfile import read_toml

CONTROL_SIGMA_M: Final = 0.1
IMAGE_SIGMA_PX: Final = 0.5
HEIGHT_SIGMA_M: Final = 5.0


def read_run(path: Path) -> RunInput:
    """Read RUN.toml; whatever is wrong in it is a `ProductError` that names it."""
    if not path.is_file():
        raise MissingFileError(path, "", "a RUN.toml expected, there is no such file")
    node = Node(path, "", read_toml(path).data).known(TABLES)
    images = tuple(node.tables("image", lambda table: _image(table.known(IMAGE))))
    if not images:
        raise ProductError(path, "[[image]]", "one or more images expected")
    ids = [image.id for image in images]
    if len(set(ids)) != len(ids):
        twice = next(name for name in ids if ids.count(name) > 1)
        raise ProductError(path, f"[[image]] {twice}", "each id once expected")
    control = _points(node.table("control").known(CONTROL)) if node.has("control") else None
    ties = _ties(node.table("ties").known(TIES)) if node.has("ties") else None
    if control is None and ties is None and not node.has("plan"):
        raise ProductError(path, "", "[control], [ties] or both expected")
    output = node.table("output").known(OUTPUT)
    return RunInput(
        path=path,
        images=images,
        control=control,
        ties=ties,
        check=_check(node.table("check").known(CHECK)),
        unknowns=tuple(node.tables("unknown", lambda table: _unknown(table.known(UNKNOWN)))),
        heights=_heights(node.table("heights").known(HEIGHTS)) if node.has("heights") else None,
        robust=_robust(node, "robust"),
        plan=_plan(node.table("plan").known(PLAN)) if node.has("plan") else None,
        output=OutputInput(
            output.flag("rpc", False),
            output.flag("csm", True),
            output.flag("models", True),
            output.flag("report", True),
        ),
    )


def _image(node: Node) -> ImageInput:
    product = node.file("product")
    if product is None:
        node.refuse("product", "the path of a product expected")
    rpc: bool | Path = False
    if isinstance(node.values.get("rpc"), bool):
        rpc = node.flag("rpc", False)
    elif node.has("rpc"):
        rpc = node.file("rpc") or False
    names = node.texts("id")
    return ImageInput(
        id=product.stem if names is None else names[0],
        product=product,
        rpc=rpc,
        pixels=node.file("image"),
        fixed=node.flag("fixed", False),
    )


def _points(node: Node) -> PointsInput:
    file = node.file("file")
    if file is None:
        node.refuse("file", "the path of a table of control points expected")
    # `datum = "orthometric"` speaks of heights, `datum = "EPSG:32631"` of the plane.
    words: dict[str, tuple[str, ...]] = {
        "ellipsoidal": ("ellipsoid", "ellipsoidal_heights", "hae"),
        "orthometric": ("geoid", "msl", "mean_sea_level"),
    }
    crs, vertical = node.values.get("crs"), "heights" if node.has("heights") else ""
    if isinstance(crs, str) and any(crs.lower() in (w, *o) for w, o in words.items()):
        crs, vertical = None, "crs"
    if isinstance(crs, int) and not isinstance(crs, bool):
        crs = f"EPSG:{crs}"
    if crs is not None and not isinstance(crs, str):
        node.refuse("crs", f'a coordinate system such as "EPSG:32631" expected, got {crs!r}')
    if isinstance(crs, str) and crs.upper().replace(" ", "").replace("_", "") == "WGS84":
        crs = "EPSG:4326"
    geoid = node.file("geoid")
    if vertical and node.choice(vertical, words, "ellipsoidal") == "orthometric":
        if geoid is None:
            node.refuse("geoid", "a geoid grid expected: the heights are said to be orthometric")
    elif vertical and geoid is not None:
        node.refuse("geoid", "no geoid expected: the heights are said to be ellipsoidal")
    dem, dem_geoid = node.file("dem"), node.file("dem_geoid")
    return PointsInput(
        file=file,
        image_points=node.file("image_points"),
        sigma_m=node.numbers("sigma_m", 3) or (CONTROL_SIGMA_M,) * 3,
        image_sigma_px=node.number("image_sigma_px", IMAGE_SIGMA_PX) or IMAGE_SIGMA_PX,
        crs=crs,
        geoid=geoid,
        dem=dem,
        dem_geoid=dem_geoid or (geoid if dem is not None else None),
    )


def _ties(node: Node) -> TiesInput:
    match = node.flag("match", False)
    value = node.texts("file") or ()
    files = tuple(node.path.parent / name for name in value)
    for file in files:
        if not file.is_file():
            node.refuse("file", f"an existing file expected, there is no {file}")
    if match == bool(files):
        node.refuse("file", "either a file of ties or match = true expected")
    sigma = node.number("sigma_px", IMAGE_SIGMA_PX)
    images = node.texts("images")
    if images is not None and len(images) != 2:
        node.refuse("images", f"the ids of two images expected, got {len(images)}")
    return TiesInput(files, match, sigma or IMAGE_SIGMA_PX, images)


def _check(node: Node) -> CheckInput:
    ways = [key for key in ("file", "ids", "every", "fraction") if node.has(key)]
    if len(ways) > 1:
        node.refuse(ways[1], f"one of file, ids, every and fraction expected, {ways[0]} is given")
    fraction = node.number("fraction")
    if fraction is not None and fraction >= 1.0:
        node.refuse("fraction", f"a number between 0 and 1 expected, got {fraction:g}")
    return CheckInput(
        file=node.file("file"),
        image_points=node.file("image_points"),
        ids=node.texts("ids") or (),
        every=node.integer("every", None, 2, 10**6),
        fraction=fraction,
        leave_one_out=node.flag("leave_one_out", False) if node.has("leave_one_out") else None,
    )


def _unknown(node: Node) -> UnknownInput:
    if not node.has("kind"):
        node.refuse("kind", f"one of {', '.join(KINDS)} expected")
    kind = node.choice("kind", KINDS, "")
    degree = node.values.get("degree")
    if isinstance(degree, str):
        if degree.lower() not in DEGREES:
            node.refuse("degree", f"a number or one of {', '.join(DEGREES)} expected")
        degree = DEGREES[degree.lower()]
    elif degree is not None:
        degree = node.integer("degree", None, 0, 5)
    knots = node.values.get("knots")
    if isinstance(knots, list):
        if not all(isinstance(k, (int, float)) and not isinstance(k, bool) for k in knots):
            node.refuse("knots", "a number of knots or a list of lines expected")
        knots = tuple(float(k) for k in knots)
    elif knots is not None:
        knots = node.integer("knots", None, 2, 1000)
    return UnknownInput(
        kind=kind,
        name=node.text("name"),
        images=node.texts("images"),
        shared=node.flag("shared", False) if node.has("shared") else None,
        degree=degree,
        knots=knots,
        smooth=node.flag("smooth", True),
        spacing_s=node.number("spacing_s", 1.0) or 1.0,
        sigma=node,
    )


def _heights(node: Node) -> HeightsInput:
    dem = node.file("dem")
    if dem is None:
        node.refuse("dem", "the path of a DEM expected")
    sigma = node.number("sigma_m", HEIGHT_SIGMA_M)
    return HeightsInput(dem, node.file("geoid"), sigma or HEIGHT_SIGMA_M)


def _robust(root: Node, key: str) -> RobustInput:
    if isinstance(root.values.get(key), bool):
        return RobustInput(root.flag(key, True))
    node = root.table(key).known(ROBUST)
    methods: dict[str, tuple[str, ...]] = {"gnc": ("tls", "gnc_tls"), "none": ("off", "l2")}
    method: Literal["gnc", "none"] | str = node.choice("method", methods, "gnc")
    risk = node.number("family_risk", FAMILY_RISK) or FAMILY_RISK
    if risk >= 0.5:
        node.refuse("family_risk", f"a number below 0.5 expected, got {risk:g}")
    return RobustInput(node.flag("enabled", method == "gnc"), risk, node.flag("adapt", True))


def _plan(node: Node) -> PlanInput:
    count = node.integer("count", 6, 1, 500) or 6
    candidates: int | Path
    if isinstance(node.values.get("candidates"), str):
        found = node.file("candidates")
        assert found is not None
        candidates = found
    else:
        candidates = node.integer("candidates", 49, 4, 2500) or 49
    height = node.values.get("height_m")
    if height is not None and (isinstance(height, bool) or not isinstance(height, (int, float))):
        node.refuse("height_m", f"a height in metres expected, got {height!r}")
    return PlanInput(
        count,
        candidates,
        None if height is None else float(height),
        node.numbers("sigma_m", 3) or (CONTROL_SIGMA_M,) * 3,
        node.number("image_sigma_px", IMAGE_SIGMA_PX) or IMAGE_SIGMA_PX,
    )
