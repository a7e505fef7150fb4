"""Make `orekit_frames.json`: frames, times and geodetic points by Orekit, an outside authority.

Run by hand, once, in an environment of its own (Java 11 or newer):

    pip install orekit-jpype pyerfa astropy-iers-data
    python make_orekit_frames.py

Orekit brings its own IAU 2006/2000A series. It is fed the C04 file of astropy-iers-data and
the leap seconds of pyerfa (in IERS `UTC-TAI.history` form), without tidal corrections to the
daily values. For each epoch the Earth orientation that Orekit itself interpolated is stored
too, so that the chain can be tested apart from the tables.
"""

import json
import shutil
import tempfile
from importlib.metadata import version
from pathlib import Path

import astropy_iers_data
import erfa
import orekit_jpype

orekit_jpype.initVM()

from java.io import File  # noqa: E402
from org.hipparchus.geometry.euclidean.threed import Vector3D  # noqa: E402
from org.orekit.bodies import GeodeticPoint, OneAxisEllipsoid  # noqa: E402
from org.orekit.data import DataContext, DirectoryCrawler  # noqa: E402
from org.orekit.frames import FramesFactory  # noqa: E402
from org.orekit.time import AbsoluteDate, TimeScalesFactory  # noqa: E402
from org.orekit.utils import Constants, IERSConventions, PVCoordinates  # noqa: E402

EPOCHS = [
    "1985-06-30T23:59:59.500",
    "2000-01-01T12:00:00.000",
    "2009-12-31T23:59:45.250",
    "2012-06-30T23:59:60.500",
    "2014-06-19T18:52:50.787577",
    "2016-12-31T23:59:60.250",
    "2017-01-01T00:00:00.000",
    "2018-05-06T10:11:12.345678",
    "2020-02-29T06:00:00.000",
    "2023-06-01T17:30:00.125",
    "2025-11-05T03:04:05.678",
]
POSITION_M = (-3102345.678, 5210987.654, 3350123.456)
VELOCITY_M_S = (-4310.25, -5012.75, 3805.5)
MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"]


def data_folder(folder: Path) -> None:
    shutil.copy(astropy_iers_data.IERS_B_FILE, folder / "eopc04.62")
    rows = [(int(y), int(m), float(s)) for y, m, s in erfa.leap_seconds.get() if y >= 1972]
    lines = [
        " ---------------",
        " UTC-TAI.history",
        " ---------------",
        " RELATIONSHIP BETWEEN TAI AND UTC",
        " -------------------------------------------------------------------------------",
        " Limits of validity(at 0h UTC)       TAI - UTC",
        "",
    ]
    for i, (year, month, offset) in enumerate(rows):
        end = ""
        if i + 1 < len(rows):
            end = f"{rows[i + 1][0]:4d}  {MONTHS[rows[i + 1][1] - 1]}.  1"
        lines.append(f" {year:4d}  {MONTHS[month - 1]}.  1 - {end:<14s}     {offset:.0f}s")
    lines.append(" -------------------------------------------------------------------------------")
    (folder / "UTC-TAI.history").write_text("\n".join(lines) + "\n")


def numbers(vector) -> list[float]:
    return [float(vector.getX()), float(vector.getY()), float(vector.getZ())]


def matrix(transform) -> list[list[float]]:
    return [[float(v) for v in row] for row in transform.getRotation().getMatrix()]


def frame_case(text: str, gcrf, itrf, history) -> dict:
    utc = TimeScalesFactory.getUTC()
    date = AbsoluteDate(text, utc)
    transform = gcrf.getTransformTo(itrf, date)
    moved = transform.transformPVCoordinates(
        PVCoordinates(Vector3D(*POSITION_M), Vector3D(*VELOCITY_M_S))
    )
    pole = history.getPoleCorrection(date)
    celestial = history.getNonRotatinOriginNutationCorrection(date)
    tai = AbsoluteDate(2000, 1, 1, 0, 0, 0.0, TimeScalesFactory.getTAI())
    gps = AbsoluteDate.GPS_EPOCH
    return {
        "utc": text,
        "tai_s": date.durationFrom(tai),
        "gps_s": date.durationFrom(gps),
        "tai_minus_utc_s": -float(utc.offsetFromTAI(date).toDouble()),
        "ut1_minus_tai_s": float(TimeScalesFactory.getUT1(history).offsetFromTAI(date).toDouble()),
        "xp_rad": float(pole.getXp()),
        "yp_rad": float(pole.getYp()),
        "dx_rad": float(celestial[0]),
        "dy_rad": float(celestial[1]),
        "matrix_itrs_gcrs": matrix(transform),
        "rate_itrs_rad_s": numbers(transform.getRotationRate()),
        "position_itrs_m": numbers(moved.getPosition()),
        "velocity_itrs_m_s": numbers(moved.getVelocity()),
    }


def geodetic_cases(itrf) -> list[dict]:
    earth = OneAxisEllipsoid(
        Constants.WGS84_EARTH_EQUATORIAL_RADIUS, Constants.WGS84_EARTH_FLATTENING, itrf
    )
    cases = []
    for lat in (-1.57, -1.1, -0.4, 0.0, 1e-6, 0.785, 1.3, 1.5707):
        for lon, height in ((-3.1, -400.0), (0.25, 0.0), (1.9, 8848.0), (2.9, 5.06e5)):
            point = earth.transform(GeodeticPoint(lat, lon, height))
            cases.append({"geodetic": [lon, lat, height], "ecef_m": numbers(point)})
    return cases


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        data_folder(Path(name))
        manager = DataContext.getDefault().getDataProvidersManager()
        manager.addProvider(DirectoryCrawler(File(name)))
        simple = True  # no tidal corrections
        itrf = FramesFactory.getITRF(IERSConventions.IERS_2010, simple)
        gcrf = FramesFactory.getGCRF()
        history = FramesFactory.getEOPHistory(IERSConventions.IERS_2010, simple)
        cases = [frame_case(text, gcrf, itrf, history) for text in EPOCHS]
        bias = gcrf.getTransformTo(FramesFactory.getEME2000(), AbsoluteDate.J2000_EPOCH)
        content = {
            "provenance": {
                "made_by": "make_orekit_frames.py",
                "orekit_jpype": version("orekit-jpype"),
                "astropy_iers_data": version("astropy-iers-data"),
                "earth_orientation": "C04 file of astropy-iers-data, no tidal corrections",
            },
            "position_gcrs_m": POSITION_M,
            "velocity_gcrs_m_s": VELOCITY_M_S,
            "frames": cases,
            "matrix_eme2000_gcrs": matrix(bias),
            "geodetic": geodetic_cases(itrf),
        }
    Path(__file__).with_name("orekit_frames.json").write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
