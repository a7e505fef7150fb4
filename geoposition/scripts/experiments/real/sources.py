"""Which public files each chain needs, and which of them are there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from geoposition.errors import MissingFileError

WORLDVIEW: Final = "worldview2-pair"
VENTOUX: Final = "pleiades-ventoux"
REUNION: Final = "pleiades-reunion"


@dataclass(frozen=True, slots=True)
class Sources:
    """Files of one chain by name, relative to the samples' folder, and where they come from."""

    title: str
    origin: str
    files: Mapping[str, str]

    @property
    def folders(self) -> tuple[str, ...]:
        """Folders of the files, each once."""
        return tuple(dict.fromkeys(str(Path(name).parent) for name in self.files.values()))


SOURCES: Final[Mapping[str, Sources]] = {
    WORLDVIEW: Sources(
        "WorldView-2 pair: product to model, control, RPC",
        "NeoGeographyToolkit/StereoPipeline, Apache-2.0; rights of Maxar",
        {
            "wv1": "linescan/worldview2_pair/wv_mvp_1.xml",
            "wv2": "linescan/worldview2_pair/wv_mvp_2.xml",
        },
    ),
    VENTOUX: Sources(
        "Mont Ventoux: Pléiades pair to surface, against SRTM",
        "CNES/shareloc, Apache-2.0; rights of Airbus and CNES",
        {
            "left": "stereo/pleiades_ventoux/left_image.geom",
            "right": "stereo/pleiades_ventoux/right_image.geom",
            "left_image": "stereo/pleiades_ventoux/left_image.tif",
            "right_image": "stereo/pleiades_ventoux/right_image.tif",
            "reference": "dem/N44E005.hgt",
            "geoid": "dem/egm96_15.gtx",
        },
    ),
    REUNION: Sources(
        "Réunion: Pléiades pair to surface, against another tool's",
        "centreborelli/s2p, AGPL-3.0; rights of Airbus and CNES",
        {
            "left": "stereo/pleiades_reunion/img_01.tif",
            "right": "stereo/pleiades_reunion/img_02.tif",
            "left_image": "stereo/pleiades_reunion/img_01.tif",
            "right_image": "stereo/pleiades_reunion/img_02.tif",
            "reference": "stereo/pleiades_reunion/expected_dsm.tif",
        },
    ),
}


@dataclass(frozen=True, slots=True)
class Found:
    """What is there: paths by chain and name, and for each absent chain its absent folders."""

    paths: Mapping[str, Mapping[str, Path]]
    absent: Mapping[str, tuple[str, ...]]

    def as_notes(self) -> dict[str, str]:
        """Return a sentence for each chain that was skipped."""
        return {
            name: f"skipped: no folder {' and no '.join(folders)}"
            for name, folders in self.absent.items()
        }


def find(folder: Path) -> Found:
    """Look for all chains below `folder`.

    Raises
    ------
    MissingFileError
        No chain has its folders, or a folder is there without one of its files.
    """
    if not folder.is_dir():
        raise MissingFileError(folder, "", "a folder with the public samples expected")
    paths: dict[str, Mapping[str, Path]] = {}
    absent: dict[str, tuple[str, ...]] = {}
    for name, sources in SOURCES.items():
        lacking = tuple(place for place in sources.folders if not (folder / place).is_dir())
        if lacking:
            absent[name] = lacking
            continue
        paths[name] = {key: folder / file for key, file in sources.files.items()}
        for path in paths[name].values():
            if not path.is_file():
                raise MissingFileError(path, "", f"a file of {sources.origin} expected here")
    if not paths:
        chains = "; or ".join(" and ".join(each.folders) for each in SOURCES.values())
        raise MissingFileError(folder, "", f"the folders of a chain expected: {chains}")
    return Found(paths, absent)
