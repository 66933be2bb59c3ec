"""Damaged scenarios, rasters, records, campaigns and command lines: errors of the package only."""

from __future__ import annotations

import contextlib
import shutil
import warnings

import numpy as np
import pytest
import rasterio
import tomli_w
from click.testing import CliRunner

from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import run
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.world.terrain.dtm import load_terrain, read_info
from tests.campaign.surrogate import plan
from tests.security import fuzz, test_campaigns, test_records
from tests.worlds import SCENARIOS, TINY_FLIGHT

FULL = Scenario.load(SCENARIOS / "golombek.toml").to_dict()
SPEC = {
    "name": "c", "flights": 3, "scenario": TINY_FLIGHT,
    "factors": {"policy": ["safest", "no-divert"], "rocks.cover": [0.0, 0.1]},
    "dispersions": {"start.position_m.0": {"kind": "normal", "mean": -600.0, "sigma": 30.0}},
}  # fmt: skip
COMMANDS = (
    ["scenario", "check"], ["campaign", "status"], ["campaign", "plan"], ["campaign", "diff"],
    ["terrain", "info"], ["replay"], ["parts"], ["scenario", "show"], ["scenario", "new"],
    ["campaign", "export"], ["campaign", "rare"], ["campaign", "sensitivity"],
)  # fmt: skip
WORDS = (
    "--set", "--out", "--flight", "--seed", "--metric", "--allow-module", "--above", "--margin",
    "golombek", "mare", "policy", "s.toml", "c", "gone", "", "-", "--", "-1", "1e400", "nan", "0-0",
    "99999999999999999999-0", "rocks.cover=0.1", "rocks.cover=", "=", "a=b=c", "policy=os:x",
    "sun.elevation_deg=1e999", "terrain={kind=1}", "start.position_m.9=1", "\u202e", "é",
    "x" * 3000, "[" * 2000, "rocks.cover=" + "[" * 2000, "policy={a=" * 500, "/dev/null",
    "/", "..", ".",
)  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Return a folder with a whole one of each kind of file."""
    place = tmp_path_factory.mktemp("fuzz")
    Simulation(Scenario.from_dict(TINY_FLIGHT), 1, "safest").run().save(place / "record")
    run(plan(), InlineEngine(), place / "campaign")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(
            place / "z.tif", "w", driver="GTiff", height=32, width=32, count=1, dtype="float32",
            crs="+proj=eqc +R=1737400 +units=m", tiled=True, blockxsize=16, blockysize=16,
            transform=rasterio.transform.from_origin(0.0, 32.0, 1.0, 1.0), compress="deflate",
        ) as file:  # fmt: skip
            file.write(np.random.default_rng(1).random((32, 32), np.float32), 1)
    for name in ("record", "campaign"):
        shutil.copytree(place / name, place / f"{name}-damaged")
    return place


def scenario(place, seed):
    rng = np.random.default_rng([seed, 1])
    given, read = ((FULL, Scenario), (SPEC, CampaignSpec))[int(rng.integers(2))]
    path = place / "s.toml"
    if rng.random() < 0.3:
        path.write_bytes(fuzz.damaged_bytes(tomli_w.dumps(given).encode(), rng))
        return lambda: read.load(path)
    tables = fuzz.damaged_tables(given, rng)
    return lambda: read.from_dict(tables)


def raster(place, seed):
    rng = np.random.default_rng([seed, 2])
    path = place / "damaged.tif"
    path.write_bytes(fuzz.damaged_bytes((place / "z.tif").read_bytes(), rng))

    def read():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read_info(path)
            load_terrain(path)

    return read


def record(place, seed):
    test_records.damaged(place / "record-damaged", place / "record", seed)
    return lambda: test_records.use(place / "record-damaged")


def campaign(place, seed):
    folder = place / "campaign-damaged"
    test_campaigns.damaged(folder, place / "campaign", seed)

    def read():
        load_results(folder)
        test_campaigns.ends_well(folder, test_campaigns.COMMANDS[seed % 4])

    return read


def command(place, seed):
    rng = np.random.default_rng([seed, 3])
    words = [str(w) for w in rng.choice(WORDS, int(rng.integers(5)))]
    line = [*COMMANDS[int(rng.integers(len(COMMANDS)))], *words]

    def call():
        done = CliRunner().invoke(main, line)
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        assert done.exit_code in (0, 1, 2), done.output

    return call


KINDS = {"toml": scenario, "tiff": raster, "record": record, "campaign": campaign,
         "command": command}  # fmt: skip


def check(kind, place, seeds):
    accepted = 0
    with contextlib.chdir(place):
        for seed in seeds:
            accepted += fuzz.survives(KINDS[kind](place, seed), f"{kind} {seed}")
    assert kind == "command" or accepted < len(seeds)


@pytest.mark.parametrize("kind", KINDS)
def test_some_damages_of_each_kind(place, kind):
    check(kind, place, range(40))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_twenty_thousand_damages(place, kind):
    check(kind, place, range(1000, 5000))


@pytest.mark.parametrize("kind", [[], {}, None, 1, ["normal"], "x"])
def test_a_distribution_of_no_kind_is_refused(kind):
    dispersions = {"sun.elevation_deg": {"kind": kind, "low": 1.0, "high": 2.0}}
    with pytest.raises(InputError, match=r"dispersions\.sun"):
        CampaignSpec.from_dict(SPEC | {"dispersions": dispersions})
