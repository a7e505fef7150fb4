"""A RUN.toml with every key, as `geoposition adjust --example` prints it."""

from typing import Final

EXAMPLE: Final = """\
# RUN.toml of `geoposition adjust RUN.toml -o DIR`. Paths are relative to this file.
# Keys that are commented out show their default, or another possibility.

[[image]]                     # one for each image, in any order
id = "left"                   # its name in tables and results; the file's name by default
product = "left.XML"          # any product: metadata, folder, image with RPC, RPC, CSM, .toml
# rpc = true                  # adjust the product's RPC instead of its rigorous model;
# rpc = "left.RPB"            # or this RPC
# image = "left.tif"          # its pixels, for match = true, where they do not lie beside it
# fixed = true                # keep this image as it is (without [[unknown]] of its own)

[[image]]
id = "right"
product = "right.XML"

[control]                     # ground control; may be left out where there are ties
file = "gcps.csv"             # .csv .parquet: id,lon,lat,height[,sigma_e,sigma_n,sigma_u]
                              #   and product,row,col[,sigma_px], a row an image point,
                              #   or row_left,col_left,row_right,col_right
                              # .geojson .gpkg .shp: the same as attributes of points
                              # .gcp (Ames Stereo Pipeline), .points (QGIS)
# image_points = "gcps_px.csv"  # id,product,row,col where they are in a table of their own;
                              #   otherwise they are looked for among the ties, by id
sigma_m = 0.05                # of positions that bring none: one, or [east, north, up] (0.1)
image_sigma_px = 0.3          # of their image points (0.5)
# crs = "EPSG:32631"          # of x,y or lon,lat; the file's own, else WGS 84 in degrees
# geoid = "egm96_15.gtx"      # makes heights above the geoid ellipsoidal; without it they are
# dem = "dem.tif"             # heights of points that have none (QGIS)
# dem_geoid = "egm96_15.gtx"  # makes the DEM's heights ellipsoidal; [control] geoid by default

[ties]                        # the same ground in several images
match = true                  # find them in the images,
# file = "ties.csv"           # or a table id,product,row,col, or a text of ASP's matches;
                              #   several: ["a.csv", "b.csv"]
# images = ["left", "right"]  # of a text of matches that does not name its images
sigma_px = 0.5                # of their image points

[check]                       # points kept out, to compare with; one of these ways
every = 4                     # each fourth control point
# ids = ["p3", "p7"]
# fraction = 0.25
# file = "check.csv"          # as [control] file; image_points = "..." likewise
# leave_one_out = true        # each control point predicted by the others; by itself for few

[[unknown]]                   # none at all: attitude_bias of rigorous images, image_bias of RPCs
kind = "attitude_bias"        # roll, pitch, yaw of the body, functions of time
# images = ["left", "right"]  # all that can, by default
# shared = false              # true: one set for all these images, such as a strip
degree = 0                    # 0 constant, 1 linear, 2 quadratic
sigma_arcsec = 100.0          # prior, one or [roll, pitch, yaw]; sigma_rad, too
# [[unknown]]
# kind = "attitude_spline"    # knots = 5 or a list of lines; smooth = true; sigma_arcsec = 100.0
# [[unknown]]
# kind = "attitude_process"   # the product's own attitude covariance; spacing_s = 1.0
# [[unknown]]
# kind = "mounting"           # camera to body, shared by its images; sigma_arcsec = 100.0
# [[unknown]]
# kind = "orbit"              # sigma_m = 5.0; drift_sigma_m_s = 0.01 for drifts, too
# [[unknown]]
# kind = "time_offset"        # sigma_s = 0.001
# [[unknown]]
# kind = "look_angles"        # degree = 2; sigma_arcsec = 10.0; shared by the images
# [[unknown]]
# kind = "image_bias"         # degree 0 shift, 1 affine; sigma_px = 100.0; for any model

# [heights]                   # heights of ties from a DEM
# dem = "srtm.hgt"
# geoid = "egm96_15.gtx"      # makes them ellipsoidal
# sigma_m = 5.0

# [robust]
# enabled = true              # look for blunders
# family_risk = 1e-4          # chance that an adjustment without blunders rejects a point
# adapt = true                # widen limits where the stated sigmas are too small

# [plan]                      # where control would help most; works without measurements, too
# count = 6                   # points to choose
# candidates = 49             # from a grid of so many, or from a file id,lon,lat,height
# sigma_m = 0.1
# image_sigma_px = 0.5
# height_m = 300.0            # of the grid; the middle of the model's range

[output]
rpc = false                   # also an RPC of each adjusted rigorous model
csm = true                    # CSM states of rigorous models
# models = true
# report = true
"""
