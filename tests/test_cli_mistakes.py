"""Every command's bad input: code 2, one line with field, value and remedy, nothing written."""

from __future__ import annotations

import json
import re
from pathlib import Path

import click
import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from rasterio.transform import from_origin

from lunarsim.cli import main
from tests.worlds import SCENARIOS, TAKE_A_SCENARIO

GOOD = str(SCENARIOS / "golombek.toml")
SPEC = str(SCENARIOS / "campaigns" / "hard.toml")

AT = ["--at", "0", "0", "--time", "2027-03-01T12:00Z"]

# Of every command that takes a scenario: arguments, and what the line must hold.
OF_A_SCENARIO = [
    (["gone.toml"], ["scenario", "gone.toml", "an existing TOML file"]),
    (
        ["hirisee"],
        ["scenario: ", "got 'hirisee'", "an existing TOML file", "Did you mean 'hirise'"],
    ),
    (["qqq"], ["scenario: ", "got 'qqq'", "an existing TOML file", "`lunarsim scenario list`"]),
    (["empty.toml"], ["scenario", "empty.toml", "at least one key"]),
    (["broken.toml"], ["scenario", "broken.toml", "a valid TOML file"]),
    (["folder"], ["scenario", "folder", "an existing TOML file"]),
    (["x" * 300 + ".toml"], ["x.toml: File name too long"]),
    (["wrong.toml"], ["sun.elevation_deg: ", "got 95.0", "at most 90"]),
    (["short.toml"], ["start.position_m: ", "got [-900, 0]", "a list of 3 values in m"]),
    (["chosen.toml"], ["policy: ", "got 'safest'", 'a table [policy] with kind = "safest"']),
    (["wide.toml"], ["scenario", "wide.toml", "a text file in UTF-8"]),
    (["words.toml"], ["vehicle.dry_mass_kg: ", "got '1100'", "Delete the quotes."]),
    (
        [GOOD, "--set", "start.position_m=5"],
        ["--set start.position_m: ", "got 5", "a list of 3 values"],
    ),
    ([GOOD, "--set", "rocks=0.08"], ["--set rocks: ", "got 0.08", "a table [rocks]"]),
    ([GOOD, "--set", "rocks.cover"], ["--set", "KEY=VALUE"]),
    ([GOOD, "--set", "rocks.covr=0.1"], ["--set rocks.covr", "Did you mean 'cover'"]),
    (
        [GOOD, "--set", "terrain.size_m=1e9"],
        ["1000000000.0", "55.5 EiB", "at most 5000 m (20000 points of 0.25 m)"],
    ),
    (
        [GOOD, "--set", "mappers.dem.size_m=1e6"],
        ["1000000.0", "90.9 TiB", "at most 1600 m (8000 cells of 0.2 m)"],
    ),
]
# Of every command: arguments of its own, and what the line must hold.
OWN = {
    "view": [
        (["gone"], ["view: ", "needs a display", "--save"]),
        (["gone", "--save", "x.rrd"], ["flight: ", "got 'gone'", "contains flight.json"]),
        (["gone", "--save", "x.txt"], ["--save: ", "got 'x.txt'", "ends in .rrd"]),
        (["gone", "--save", "none/x.rrd"], ["--save: ", "none/x.rrd", "existing folder"]),
    ],
    "film": [
        (["gone"], ["flight: ", "got 'gone'", "contains flight.json"]),
        (["gone", "--out", "x.avi"], ["--out: ", "got 'x.avi'", ".mp4 or .gif"]),
        (["gone", "--seconds", "0.1"], ["--seconds", "1.0<=x<=600.0"]),
        (["gone", "--seconds", "nan"], ["--seconds", "nan", "1.0<=x<=600.0"]),
    ],
    "fly": [
        ([GOOD, "--policy", "safset"], ["--policy: ", "got 'safset'", "Did you mean 'safest'"]),
        ([GOOD, "--guidance", "apolo"], ["--guidance: ", "got 'apolo'", "Did you mean 'apollo'"]),
        ([GOOD, "--view"], ["--view: ", "needs a display", "--save"]),
        ([GOOD, "--pace", "nan"], ["--pace", "nan", "x>0"]),
        ([GOOD, "--seed", "-1"], ["--seed", "-1", "x>=0"]),
        ([GOOD, "--seed", "1.5"], ["--seed", "'1.5' is not a valid integer."]),
        ([GOOD, "--flight", "many"], ["--flight", "many", "integer"]),
        ([GOOD, "--out", "full"], ["--out: ", "got 'full'", "new or empty folder"]),
        ([GOOD, "--out", "hides"], ["--out: ", "got 'hides'", "new or empty folder"]),
        ([GOOD, "--out", "wrong.toml"], ["--out: ", "got 'wrong.toml'", "a folder, not a file"]),
        ([GOOD, "--out", "/proc/none"], ["--out: ", "got '/proc/none'", "can create files"]),
        (["cut.toml"], ["terrain.path", "cut.tif", "cannot be read"]),
        (["bands.toml"], ["terrain.path", "bands.tif", "one band"]),
        (["high.toml"], ["terrain.path", "high.tif", "1e+30", "has heights from"]),
        ([GOOD, "--set", "terrain.posting_m=1000"],
         ["terrain.posting_m", "1000.0", "at most 80 m, half of size_m"]),
        ([GOOD, "--set", "target.position_m=[900, 0]"], ["target.position_m", "is on the terrain"]),
        ([GOOD, "--frobnicate"], ["--frobnicate", "fly --help"]),
        ([], ["SCENARIO", "fly --help"]),
    ],
    "compare": [
        (
            [GOOD, "--out", "new", "--policies", "safest,safest"],
            ["--policies", "each policy only once"],
        ),
        ([GOOD, "--out", "new", "--policies", "safset"], ["'safset'", "Did you mean 'safest'"]),
        ([GOOD, "--out", "new", "--flights", "0"], ["--flights: ", "got 0", "1 or more"]),
        ([GOOD, "--out", "new", "--jobs", "0"], ["--jobs: ", "got 0", "1 or more"]),
        ([GOOD, "--out", "full", "--flights", "1"],
         ["--out: ", "got 'full'", "new or empty folder"]),
        ([GOOD, "--out", "/proc/none"], ["--out: ", "got '/proc/none'", "can create files"]),
        ([GOOD], ["--out", "compare --help"]),
    ],
    "calibrate": [
        ([GOOD, "--out", "c.txt"], ["--out: ", "got 'c.txt'", ".json"]),
        ([GOOD, "--out", "none/c.json"], ["--out: ", "got 'none/c.json'", "existing folder"]),
        ([GOOD, "--out", "there.json"], ["--out: ", "got 'there.json'", "--force"]),
        ([GOOD, "--out", "c.json", "--flights", "1"], ["--flights: ", "got 1", "2 or more"]),
        ([GOOD, "--out", "c.json", "--mapper", "dam"],
         ["--mapper: ", "got 'dam'", "Mappers of this kind: dem"]),
    ],
    "render": [
        ([GOOD, "--out", "x.jpg"], ["--out: ", "got 'x.jpg'", ".png"]),
        ([GOOD, "--out", "x.png", "--altitude", "-5"],
         ["--altitude: ", "got -5.0", "above 0"]),
        ([GOOD, "--out", "x.png", "--altitude", "nan"],
         ["--altitude: ", "got nan", "above 0"]),
        ([GOOD, "--out", "x.png", "--off-nadir", "89"],
         ["--off-nadir: ", "got 89", "0 or more and below 85"]),
        ([GOOD, "--out", "x.png", "--sun-elevation", "95"],
         ["sun.elevation_deg: ", "got 95.0", "90"]),
        ([GOOD, "--out", "x.png", "--exposure", "0"], ["--exposure", "0.0<x<=100.0"]),
        ([GOOD, "--out", "x.png", "--truth", "x.txt"], ["--truth: ", "got 'x.txt'", ".npz"]),
        ([GOOD, "--out", "x.png", "--heading", "inf"], ["--heading: ", "got inf", "finite"]),
    ],
    "sweep": [
        ([GOOD, "--out", "new", "--over", "rocks.cover"], ["--over", "KEY=A,B,C"]),
        ([GOOD, "--out", "new", "--over", "rocks.cover=0.1,0.9"],
         ["--over rocks.cover: ", "got 0.9"]),
        ([GOOD, "--out", "new", "--over", "sun.elevation=5"], ["--over sun.elevation", "_deg"]),
        ([GOOD, "--out", "new", "--set", "policy=safest", "--over", "policy=safest,no-divert"],
         ["--set: ", "got 'policy=safest'", "must not set a key that --over sets"]),
        ([GOOD, "--out", "full", "--over", "rocks.cover=0.1", "--flights", "1"], ["--out", "full"]),
        ([GOOD, "--out", "/proc/none", "--over", "rocks.cover=0.1"], ["--out", "/proc/none"]),
    ],
    "replay": [
        (["folder", "--flight", "0-0"], ["folder", "manifest.json"]),
        (["gone", "--flight", "0-0"], ["gone", "manifest.json"]),
    ],
    "evaluate": [
        (["Guidance-v1", "--agent", "apolo"],
         ["--agent: ", "got 'apolo'", "Did you mean 'apollo'"]),
        (["Guidance-v1", "--agent", "gone.npz"],
         ["--agent: ", "got 'gone.npz'", "an existing file"]),
        (["Guidance-v1", "--agent", "broken.npz"], ["--agent: ", "got 'broken.npz'", "a network"]),
        (["Guidance-v1", "--agent", "broken.zip"], ["broken.zip", "saved by Stable-Baselines3"]),
        (["Guidance-v1", "--agent", "json:gone"],
         ["--agent: ", "got 'json:gone'", "has no attribute"]),
        (["Guidance-v1", "--agent", "safest"], ["--agent: ", "got 'safest'", "needs Retarget-v1"]),
        (["Control-v1", "--agent", "polynomial"],
         ["--agent: ", "got 'polynomial'", "needs Guidance-v1"]),
        (["Guidance-v1", "--agent", "zero", "--agent", "zero"], ["--agent", "a different name"]),
        (["Guidanse-v1", "--agent", "zero"], ["Did you mean 'lunarsim/Guidance-v1'"]),
        (["gone:x-v0", "--agent", "zero"], ["env: ", "got 'gone:x-v0'", "can be imported"]),
        (["Guidance-v1", "--agent", "zero", "--episodes", "0"], ["--episodes", "0", "x>=1"]),
        (["Guidance-v1", "--agent", "zero", "--jobs", "0"], ["--jobs", "0", "x>=1"]),
        (["Guidance-v1", "--agent", "zero", "--within", "inf"],
         ["--within: ", "got inf", "finite"]),
        (["Guidance-v1", "--agent", "zero", "--out", "full"],
         ["--out: ", "got 'full'", "new or empty"]),
        (["Guidance-v1", "--agent", "zero", "--scenario", "hirisee"], ["Did you mean 'hirise'"]),
        (["Guidance-v1", "--agent", "zero", "--set", "rocks.covr=1"], ["Did you mean 'cover'"]),
        (["Retarget-v1", "--agent", "zero", "--perception", "fuse"], ["Did you mean 'fused'"]),
        (["Guidance-v1", "--agent", "zero", "--perception", "truth"], ["only to Retarget-v1"]),
        (["Guidance-v1", "--agent", "zero", "--action", "site"], ["only to Retarget-v1"]),
        (["Retarget-v1", "--agent", "zero", "--action", "time_scal"],
        ["Did you mean 'time_scale'"]),
        (["Guidance-v1"], ["--agent", "evaluate --help"]),
    ],
    "agent export": [
        (["gone.zip", "--out", "x.onnx"], ["gone.zip", "saved by Stable-Baselines3"]),
        (["broken.zip", "--out", "x.onnx"], ["broken.zip", "saved by Stable-Baselines3"]),
        (["broken.zip", "--out", "x.txt"], ["--out: ", "got 'x.txt'", ".onnx"]),
        (["broken.zip"], ["--out", "agent export --help"]),
    ],
    "parts": [(["polcy"], ["contract: ", "got 'polcy'", "Did you mean 'policy'"])],
    "campaign plan": [
        (["gone.toml"], ["gone.toml", "an existing TOML file"]),
        (["empty.toml"], ["empty.toml", "at least one key"]),
        ([SPEC, "--out", "x.txt"], ["--out: ", "got 'x.txt'", ".csv"]),
        (["wrong.toml"], ["sun", "unknown key"]),
        (["gone_spec.toml"], ["terrain.path", "gone_dtm.tif", "an existing raster file"]),
        (["drawn_spec.toml", "--out", "x.csv"], ["terrain.path", "cut.tif", "cannot be read"]),
    ],
    "campaign run": [
        (["drawn_spec.toml", "--out", "new"], ["terrain.path", "cut.tif", "cannot be read"]),
        (["gone.toml", "--out", "new"], ["gone.toml", "an existing TOML file"]),
        ([SPEC, "--out", "full"], ["--out: ", "got 'full'", "new or empty folder"]),
        ([SPEC, "--out", "/proc/none"], ["--out: ", "got '/proc/none'", "can create files"]),
        ([SPEC, "--out", "new", "--address", "x:1"], ["--address: ", "got 'x:1'",
        "--engine is ray"]),
        ([SPEC, "--out", "new", "--engine", "cloud"], ["--engine", "cloud", "local"]),
        ([SPEC, "--out", "new", "--jobs", "0"], ["--jobs", "0", "x>=1"]),
    ],
    "campaign status": [(["gone"], ["gone", "manifest.json"])],
    "campaign export": [
        (["gone", "--out", "x.csv"], ["gone", "manifest.json"]),
        (["folder", "--out", "x.txt"], ["x.txt", ".csv"]),
    ],
    "campaign report": [(["gone"], ["gone", "manifest.json"])],
    "campaign sensitivity": [(["gone"], ["gone", "manifest.json"])],
    "campaign rare": [
        (["gone"], ["gone", "manifest.json"]),
        (["gone", "--above", "x"], ["--above", "x"]),
    ],
    "campaign verify": [
        (["gone", "gone.toml"], ["requirements: ", "got 'gone.toml'", "an existing TOML file"]),
        (["folder", GOOD], ["is an unknown table", "[[requirements]]"]),
        (["folder", "gone.toml", "--out", "x.txt"], ["--out: ", "got 'x.txt'", ".json"]),
    ],
    "campaign threshold": [
        (["gone"], ["gone", "manifest.json"]),
        (["folder", "--max-risk", "1"], ["--max-risk", "1"]),
    ],
    "campaign diff": [
        (["gone", "folder"], ["gone", "manifest.json"]),
        (["gone", "folder", "--margin", "2"], ["--margin", "2"]),
    ],
    "scenario check": [
        (["gone_dtm.toml"], ["terrain.path", "gone_dtm.tif", "an existing raster file"]),
        (["cut.toml"], ["terrain.path", "cut.tif", "cannot be read"]),
        (["high.toml"], ["terrain.path", "high.tif", "has heights from"]),
        ([GOOD, "--set", "vehicle.thrust_max_n=2000"], ["vehicle.thrust_max_n", "cannot hover"]),
        ([GOOD, "--set", "gravity_m_s2=0.4"], ["vehicle.thrust_min_n", "cannot descend"]),
        (["loop.toml"], ["scenario: ", "got 'loop.toml'", "an existing TOML file"]),
        ([GOOD, "--set", "policy=safset"], ["must be a known name, or", "Did you mean 'safest'?"]),
        ([GOOD, "--set", "mappers.dem.calibration_path=gone.json"], ["calibration_path", "gone"]),
        (["wrong.tml"], ["scenario: ", "got 'wrong.tml'", "Did you mean 'wrong.toml'"]),
    ],
    "scenario upgrade": [
        (["gone.toml"], ["FILE: ", "got 'gone.toml'", "an existing TOML file"]),
        (["empty.toml"], ["FILE: ", "got 'empty.toml'", "at least one key"]),
        (["two-names.toml"], ["FILE: ", "the old and the new name of a key"]),
    ],
    "scenario show": [(["hiris"], ["NAME: ", "got 'hiris'", "Did you mean 'hirise'"])],
    "scenario new": [
        (["hiris"], ["NAME: ", "got 'hiris'", "Did you mean 'hirise'"]),
        (
            ["hirise", "--out", "wrong.toml"],
            ["--out: ", "got 'wrong.toml'", "a file that does not exist yet"],
        ),
        (["hirise", "--out", "x.txt"], ["--out: ", "got 'x.txt'", ".toml"]),
        (["hirise", "--out", "none/x.toml"], ["--out: ", "got 'none/x.toml'", "existing folder"]),
    ],
    "scenario list": [(["more"], ["more", "list --help"])],
    "scenario reference": [(["more"], ["more", "reference --help"])],
    "study list": [(["more"], ["more", "list --help"])],
    "study report": [
        (["landers/slush", "full"], ["study: ", "got 'landers/slush'", "'landers/slosh'"]),
        (["landers/slosh", "full"], ["folder: ", "got 'full'", "results.json", "no such file"]),
    ],
    "terrain info": [
        (["gone.tif"], ["terrain.path: ", "got 'gone.tif'", "an existing raster file"]),
        (["cut.tif"], ["terrain.path: ", "got 'cut.tif'", "cannot be read"]),
        (["bands.tif"], ["terrain.path: ", "got 'bands.tif'", "one band"]),
        (["high.tif"], ["terrain.path: ", "got 'high.tif'", "which no known body has"]),
        (["empty.toml"], ["terrain.path: ", "got 'empty.toml'", "must be a raster"]),
    ],
    "terrain import": [
        (["gone.tif", "--size", "1km", "--out", "x.toml"], ["terrain.path: ", "got 'gone.tif'"]),
        (["cut.tif", "--size", "100m", "--out", "x.toml"], ["terrain.path: ", "cannot be read"]),
        (["cut.tif", "--size", "1 mile", "--out", "x.toml"], ["--size", "such as 4km or 800m"]),
        (["cut.tif", "--size", "1km", "--out", "x.tif"], ["--out: ", "ends in .toml"]),
        (["cut.tif", "--at", "95", "0", "--size", "1km", "--out", "x.toml"],
         ["--at: ", "a latitude up to 90"]),
    ],
    "terrain preview": [
        ([GOOD, "--out", "p.jpg"], ["--out: ", "got 'p.jpg'", ".png"]),
        ([GOOD, "--out", "none/p.png"], ["--out: ", "got 'none/p.png'", "existing folder"]),
    ],
    "terrain truth": [
        ([GOOD, "--out", "t.png"], ["--out: ", "got 't.png'", ".nc"]),
        ([GOOD, "--out", "t.nc", "--posting", "0"], ["--posting: ", "got 0.0", "must be positive"]),
        ([GOOD, "--out", "t.nc", "--posting", "1e-6"], ["--size: ", "got 60.0", "12.8 PiB"]),
        ([GOOD, "--out", "t.nc", "--size", "nan"],
         ["--size: ", "got nan", "ten times --posting"]),
        ([GOOD, "--out", "t.nc", "--size", "1e9"], ["--size: ", "got 1000000000.0", "EiB"]),
    ],
    "terrain export": [
        ([GOOD, "--out", "t.png"], ["--out: ", "got 't.png'", ".tif or .ply or .glb"]),
        ([GOOD, "--out", "none/t.tif"], ["--out: ", "got 'none/t.tif'", "existing folder"]),
        ([GOOD, "--out", "t.tif", "--posting", "0"], ["--posting: ", "got 0.0", "positive"]),
        ([GOOD, "--out", "t.glb", "--posting", "1e-6"], ["--posting: ", "got 1e-06", "points"]),
        ([GOOD, "--out", "t.tif", "--posting", "nan"], ["--posting: ", "got nan", "finite"]),
        ([GOOD, "--out", "t.tif", "--set", "rocks.path='gone.csv'"],
         ["rocks.path: ", "gone.csv", "not an existing file"]),
    ],
    "export": [
        (["gone", "--format", "oem"], ["gone", "flight.json"]),
        (["folder", "--format", "oem"], ["folder", "flight.json"]),
        (["gone", "--format", "ome"], ["--format: ", "got 'ome'", "Did you mean 'oem'"]),
        (["gone"], ["--format", "export --help"]),
        (["gone", "--format", "oem", "--out", "x.txt"], ["--out: ", "got 'x.txt'", ".oem"]),
        (["gone", "--format", "oem", "--out", "none/x.oem"],
         ["--out: ", "got 'none/x.oem'", "existing folder"]),
        (["gone", "--format", "csv", "--out", "full"], ["--out: ", "got 'full'", "new or empty"]),
        (["gone", "--format", "csv", "--state", "estimate"],
         ["--state: ", "got 'estimate'", "omitted for the format csv"]),
        (["gone", "--format", "mcap", "--longitude", "5"],
         ["--longitude: ", "got 5.0", "omitted for the format mcap"]),
        (["gone", "--format", "oem", "--state", "both"],
         ["--state: ", "got 'both'", "true or estimate"]),
        (["gone", "--format", "oem", "--epoch", "now"], ["--epoch: ", "got 'now'", "2027-03-01"]),
        (["gone", "--format", "oem", "--longitude", "500"], ["--longitude: ", "got 500.0", "360"]),
    ],
    "vehicle check": [
        ([GOOD, "--json", "x.txt"], ["--json: ", "got 'x.txt'", ".json"]),
        ([GOOD, "--json", "none/x.json"], ["--json: ", "got 'none/x.json'", "existing folder"]),
        ([GOOD, "--json", "new.json", "--set", "start.position_m=[-60, 0, 5]"],
         ["start.position_m[2]: ", "got 5.0", "above 11.6 m"]),
        (["wrong.toml", "--json", "new.json"], ["sun.elevation_deg: ", "got 95.0"]),
        ([], ["SCENARIO", "vehicle check --help"]),
    ],
    "site info": [
        ([], ["SCENARIO: ", "is required, or --at and --time"]),
        (["--at", "0", "0"], ["SCENARIO: ", "is required, or --at and --time"]),
        (["--time", "2027-03-01T12:00Z"], ["SCENARIO: ", "is required, or --at and --time"]),
        ([GOOD], ["site.time: ", "is required by this command", "[site]"]),
        ([GOOD, "--at", "0", "0"], ["--at: ", "must be omitted with a scenario", "--set"]),
        ([GOOD, "--time", "now"], ["--time: ", "must be omitted with a scenario"]),
        ([*AT, "--set", "rocks.cover=0.1"], ["--set: ", "needs a scenario"]),
        (["--at", "0", "0", "--time", "2027-03-01T12:00"], ["--time: ", "time zone", "Add Z"]),
        (["--at", "0", "0", "--time", "1850-03-01T12:00Z"], ["--time: ", "from 1900 to 2100"]),
        (["--at", "91", "0", "--time", "2027-03-01T12:00Z"],
         ["--at: ", "must be between -90 and 90", "(91 deg)"]),
        ([*AT, "--dtm", "gone.tif"], ["--dtm: ", "got 'gone.tif'", "an existing raster file"]),
        ([*AT, "--dtm", "bands.tif"], ["--dtm: ", "got 'bands.tif'", "one band"]),
        ([*AT, "--dtm", "whole.tif"], ["--dtm: ", "whole.tif", "must have a height at latitude 0"]),
        ([*AT, "--dtm", "whole.tif", "--pixel", "1", "1"],
         ["--pixel: ", "the raster is georeferenced"]),
        ([*AT, "--posting", "5"], ["--posting: ", "got 5.0", "without --dtm"]),
        ([*AT, "--pixel", "5", "5"], ["--pixel: ", "without --dtm"]),
        ([*AT, "--nodata", "5"], ["--nodata: ", "without --dtm"]),
        ([*AT, "--dtm", "steps.tif", "--posting", "9"], ["--dtm: ", "Give it with --nodata"]),
        ([*AT, "--sun-elevation", "14", "5"], ["--sun-elevation: ", "two increasing angles"]),
        ([*AT, "--days", "0.01"], ["--days: ", "got 0.01", "1 to 100000 times the step of 1 h"]),
        (["--at", "0", "0", "--time", "2100-12-30T00:00Z"], ["--days: ", "end of 2100"]),
        ([*AT, "--step", "0"], ["--step", "x<=24"]),
        ([*AT, "--height", "-1"], ["--height", "x<=1000"]),
        ([*AT, "--range", "nan"], ["--range", "nan"]),
        ([*AT, "--out", "x.jpg"], ["--out: ", "got 'x.jpg'", ".png"]),
        ([*AT, "--csv", "none/x.csv"], ["--csv: ", "existing folder"]),
        ([*AT, "--json", "x.txt"], ["--json: ", "got 'x.txt'", ".json"]),
    ],
    "interface header": [
        (["law.h"], ["unexpected extra argument", "law.h"]),
        (["--out", "law.txt"], ["--out: ", "got 'law.txt'", ".h"]),
    ],
    "interface proto": [
        (["law.proto"], ["unexpected extra argument", "law.proto"]),
        (["--out", "none/law.proto"], ["--out: ", "existing folder"]),
    ],
    "interface replay": [
        (["gone", "law.so"], ["record: ", "got 'gone'"]),
        (["wrong.toml", "law.so"], ["record: ", "got 'wrong.toml'"]),
        (["gone"], ["SOFTWARE"]),
        (["gone", "law.so", "--deadline", "0"], ["--deadline", "0"]),
    ],
}  # fmt: skip
# The second choice, which the first flight does not draw, is no whole raster.
DRAWN = """
flights = 1
[scenario.terrain]
kind = "dtm"
path = "whole.tif"
[dispersions]
"terrain.path" = { kind = "choice", values = ["whole.tif", "cut.tif"], weights = [1.0, 0.0] }
"""
CASES = [(name, *case) for name, cases in OWN.items() for case in cases] + [
    (name, [*arguments, *more], words) for name, more in TAKE_A_SCENARIO.items()
    for arguments, words in OF_A_SCENARIO
] + [
    ("study run", ["landers/slush"], ["study: ", "got 'landers/slush'", "'landers/slosh'"]),
    ("study run", ["landers/slosh", "--flights", "0"], ["--flights", "0 is not in the range x>=1"]),
    ("study run", ["landers/slosh", "--out", "full"], ["--out: ", "got 'full'", "new or empty"]),
]  # fmt: skip


def _commands(group, before=()):
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from _commands(command, (*before, name))
        else:
            yield " ".join((*before, name)), command


def _raster(path, bands, top=1.0):
    z = np.linspace(0.0, top, 40 * 40, dtype=np.float32).reshape(40, 40)
    with rasterio.open(
        path, "w", driver="GTiff", height=40, width=40, count=bands, dtype="float32",
        crs="EPSG:32633", transform=from_origin(5e5, 5e6, 4.0, 4.0),
    ) as file:  # fmt: skip
        file.write(np.repeat(z[None], bands, axis=0))


@pytest.fixture(scope="module")
def mistakes(tmp_path_factory):
    """Return a folder of files that will not do."""
    here = tmp_path_factory.mktemp("mistakes")
    (here / "folder").mkdir()
    (here / "full").mkdir()
    (here / "full" / "notes.txt").write_text("mine")
    (here / "hides").mkdir()
    (here / "hides" / ".notes").write_text("mine")
    (here / "empty.toml").write_text("# nothing\n")
    (here / "two-names.toml").write_text("policy.enough = 0.9\npolicy.p_safe_min = 0.8\n")
    (here / "broken.toml").write_text("name = [")
    (here / "gone_spec.toml").write_text('scenario = "gone_dtm.toml"\nflights = 2\n')
    (here / "drawn_spec.toml").write_text(DRAWN)
    (here / "wrong.toml").write_text("[sun]\nelevation_deg = 95.0\n")
    (here / "words.toml").write_text('[vehicle]\ndry_mass_kg = "1100"\n')
    (here / "short.toml").write_text("[start]\nposition_m = [-900, 0]\n")
    (here / "chosen.toml").write_text('policy = "safest"\n')
    (here / "wide.toml").write_text('name = "mare"\n', encoding="utf-16")
    (here / "loop.toml").symlink_to("loop.toml")
    for name in ("broken.npz", "broken.zip"):
        (here / name).write_text("neither")
    (here / "there.json").write_text(json.dumps({}))
    _raster(here / "bands.tif", 3)
    _raster(here / "high.tif", 1, 1e30)
    _raster(here / "whole.tif", 1)
    _raster(here / "cut.tif", 1)
    with rasterio.open(
        here / "steps.tif", "w", driver="GTiff", height=9, width=9, count=1, dtype="float32"
    ) as file:
        file.write(np.where(np.arange(81).reshape(1, 9, 9) < 9, 0.0, 900.0).astype("float32"))
    whole = (here / "cut.tif").read_bytes()
    (here / "cut.tif").write_bytes(whole[: len(whole) // 2])
    for name in ("bands", "high", "cut", "gone_dtm"):
        (here / f"{name}.toml").write_text(f'[terrain]\nkind = "dtm"\npath = "{name}.tif"\n')
    return here


def _state(folder: Path):
    return {p: p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


def test_every_command_has_its_mistakes():
    known = dict(_commands(main))
    assert set(known) == set(OWN)
    taking = {n for n, c in known.items() if any(p.name == "changes" for p in c.params)}
    assert taking == set(TAKE_A_SCENARIO)


@pytest.mark.parametrize(
    ("command", "arguments", "words"), CASES, ids=lambda v: v if isinstance(v, str) else None
)
def test_a_mistake_is_one_line_and_leaves_nothing(command, arguments, words, mistakes, monkeypatch):
    monkeypatch.chdir(mistakes)
    before = _state(mistakes)
    done = CliRunner().invoke(main, [*command.split(), *arguments])
    assert done.exit_code == 2, done.output
    # On a machine that is new to it, it also says what it waits for.
    told = r"warning: |[Cc]ompiling kernels|  \d+ kernels in "
    lines = [line for line in done.stderr.splitlines() if not re.match(told, line)]
    assert len(lines) == 1, done.output
    assert lines[0].startswith("error: ")
    for word in words:
        assert word in lines[0]
    assert not done.stdout
    assert _state(mistakes) == before


def test_what_is_not_there_is_not_suggested(mistakes, monkeypatch):
    """A link to itself is listed in its folder, and is no file."""
    monkeypatch.chdir(mistakes)
    said = CliRunner().invoke(main, ["scenario", "check", "loop.toml"]).stderr
    assert "Did you mean 'loop.toml'" not in said


def test_a_group_alone_prints_its_help():
    for group in ([], ["campaign"], ["scenario"], ["study"], ["terrain"]):
        assert "Commands:" in CliRunner().invoke(main, group).output


def test_help_holds_no_control_characters():
    runner = CliRunner()
    for name in ["", *(n for n, _ in _commands(main)), "campaign", "scenario", "study", "terrain"]:
        text = runner.invoke(main, [*name.split(), "--help"]).output
        assert "Usage:" in text
        assert not [c for c in text if ord(c) < 32 and c != "\n"]
        assert "\\b" not in text
