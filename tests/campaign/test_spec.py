"""Specs: what is planned, how it is drawn, and what is refused."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy.stats import kstest, kstwo, norm, truncnorm, uniform

from lunarsim.campaign.dispersions import Dispersions
from lunarsim.campaign.distributions import distribution
from lunarsim.campaign.factors import parse_factors, split_changes
from lunarsim.campaign.flight_execution import build_plan
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from tests.chance import CHANCE
from tests.conftest import SCENARIOS

TEXT = f"""
scenario = "{SCENARIOS / "golombek.toml"}"
flights = 8
[factors]
policy = ["no-divert", "safest"]
sun.elevation_deg = [5.0, 20.0]
[dispersions]
"start.position_m.0" = {{ kind = "normal", mean = -600.0, sigma = 30.0 }}
start.velocity_m_s.0 = {{ kind = "truncated-normal", mean = 28.0, sigma = 1.0, low = 27.0 }}
rocks.cover = {{ kind = "uniform", low = 0.02, high = 0.1 }}
sun.azimuth_deg = {{ kind = "choice", values = [90.0, 270.0], weights = [3.0, 1.0] }}
[[correlations]]
keys = ["start.position_m.0", "start.velocity_m_s.0"]
matrix = [[1.0, 0.5], [0.5, 1.0]]
"""


def spec(**changes: object) -> CampaignSpec:
    data = tomllib.loads(TEXT) | changes
    return CampaignSpec.from_dict({k: v for k, v in data.items() if v is not None})


def test_every_combination_meets_the_same_draws():
    rows = list(build_plan(spec()).rows())
    assert len(rows) == 32
    assert [row["id"] for row in rows[:5]] == ["0-0", "0-1", "0-2", "0-3", "1-0"]
    assert [(r["policy.kind"], r["sun.elevation_deg"]) for r in rows[:4]] == [
        ("no-divert", 5.0), ("no-divert", 20.0), ("safest", 5.0), ("safest", 20.0),
    ]  # fmt: skip
    for key in ("start.position_m.0", "rocks.cover", "sun.azimuth_deg"):
        assert len({row[key] for row in rows[:4]}) == 1
        assert key == "sun.azimuth_deg" or len({row[key] for row in rows}) == 8


def test_a_flight_of_plain_monte_carlo_depends_on_its_index_alone():
    few, many = build_plan(spec()), build_plan(spec(flights=500))
    assert few.draws(7) == many.draws(7)
    one_less = {k: v for k, v in tomllib.loads(TEXT)["dispersions"].items() if k != "rocks"}
    without = build_plan(spec(dispersions=one_less))
    assert without.draws(7)["start.position_m.0"] == few.draws(7)["start.position_m.0"]
    assert build_plan(spec(seed=2)).draws(7) != few.draws(7)


def test_arms_that_share_their_terrain_are_flown_together():
    assert build_plan(spec()).groups == ((0, 1, 2, 3),)
    cover = spec(factors={"rocks.cover": [0.02, 0.1], "policy": ["safest", "no-divert"]},
                 dispersions=None, correlations=None)  # fmt: skip
    assert build_plan(cover).groups == ((0, 1), (2, 3))


def test_scenarios_hold_what_is_set_and_drawn():
    one = spec()
    scenario = one.scenario_of(3, 2)
    drawn = one.dispersions.draws(3)
    assert scenario.policy.kind == "safest" and scenario.sun.elevation_deg == 5.0
    assert scenario.start.position_m[0] == drawn["start.position_m.0"]
    assert scenario.start.position_m[1:] == one.scenario.start.position_m[1:]
    assert scenario.rocks.cover == drawn["rocks.cover"]


def test_a_spec_says_all_that_it_means():
    one = spec()
    again = CampaignSpec.from_dict(tomllib.loads(one.to_toml()))
    assert again.identity == one.identity
    assert list(build_plan(again).rows()) == list(build_plan(one).rows())
    assert spec(flights=9).identity == one.identity  # goes on with the same flights
    assert (
        spec(method="latin-hypercube").identity
        != spec(method="latin-hypercube", flights=9).identity
    )  # a design does not


def test_listed_arms():
    arms = [
        {"name": "blind", "set": {"policy": "no-divert"}},
        {"name": "fine", "set": {"mappers.dem.posting_m": 0.1, "policy": "safest"}},
    ]
    one = spec(factors=None, arms=arms)
    assert [arm.name for arm in one.arms] == ["blind", "fine"]
    assert one.arms[1].scenario.mappers["dem"].posting_m == 0.1


LAWS = {
    "normal": ({"kind": "normal", "mean": 2.0, "sigma": 3.0}, norm(2.0, 3.0)),
    "truncated": (
        {"kind": "truncated-normal", "mean": 2.0, "sigma": 3.0, "low": 0.0, "high": 4.0},
        truncnorm(-2 / 3, 2 / 3, 2.0, 3.0),
    ),
    "uniform": ({"kind": "uniform", "low": -1.0, "high": 3.0}, uniform(-1.0, 4.0)),
}


@pytest.mark.statistical
@pytest.mark.parametrize("method", ["monte-carlo", "latin-hypercube", "sobol"])
@pytest.mark.parametrize("law", LAWS)
def test_draws_follow_their_law(law, method):
    table, truth = LAWS[law]
    drawn = Dispersions({"a": distribution("a", table), "b": distribution("b", table)},
                        method=method, seed=3, flights=512)  # fmt: skip
    values = np.array([list(drawn.draws(i).values()) for i in range(512)])
    for column in values.T:
        statistic = kstest(column, truth.cdf).statistic
        # A design fills the range evenly; independent draws cannot.
        assert statistic < (kstwo(512).isf(CHANCE) if method == "monte-carlo" else 0.003)
    assert abs(np.corrcoef(values.T)[0, 1]) < norm.isf(CHANCE) / np.sqrt(512)


def test_choices_follow_their_weights():
    law = distribution("a", {"kind": "choice", "values": ["x", "y", "z"], "weights": [1, 0, 3]})
    drawn = [law.at(u) for u in (np.arange(1000) + 0.5) / 1000]
    assert {v: drawn.count(v) for v in set(drawn)} == {"x": 250, "z": 750}


@pytest.mark.statistical
def test_correlated_draws_keep_their_laws():
    one = spec()
    drawn = [one.dispersions.draws(i) for i in range(2000)]
    x = np.array([d["start.position_m.0"] for d in drawn])
    v = np.array([d["start.velocity_m_s.0"] for d in drawn])
    scores = norm.ppf(truncnorm(-1.0, np.inf, 28.0, 1.0).cdf(v))
    assert np.corrcoef(x, scores)[0, 1] == pytest.approx(
        0.5, abs=norm.isf(CHANCE) * 0.75 / np.sqrt(2000)
    )
    assert kstest(x, norm(-600.0, 30.0).cdf).pvalue > CHANCE
    assert kstest(v, truncnorm(-1.0, np.inf, 28.0, 1.0).cdf).pvalue > CHANCE


BAD = [
    ({"flights": 0}, "flights", "must be 1 or more"),
    ({"flight": 3}, "flight", "Did you mean 'flights'"),
    ({"seed": -1}, "seed", "must be 0 or more"),
    ({"name": ""}, "name", "must not be empty"),
    ({"method": "mc"}, "method", "monte-carlo"),
    ({"method": "sobol", "flights": 12}, "flights", "8 or 16"),
    ({"time_limit_s": 0}, "time_limit_s", "must be positive"),
    ({"records": "some"}, "records", "failures"),
    ({"scenario": "none.toml"}, "scenario", "existing TOML"),
    ({"scenario": "hirisee"}, "scenario", "Did you mean 'hirise'"),
    ({"scenario": None}, "scenario", "path or name of a scenario"),
    ({"factors": {"rocks.covr": [1]}}, "factors.rocks.covr", "Did you mean 'cover'"),
    ({"factors": {"policy": ["safets"]}}, "factors.policy.kind", "Did you mean 'safest'"),
    ({"factors": {"policy": []}}, "factors.policy", "at least one value"),
    ({"factors": {"policy": "safest"}}, "factors.policy", "list of values"),
    ({"factors": {"policy": ["safest", "safest"]}}, "factors.policy", "each value only once"),
    ({"factors": {"start.position_m.7": [1.0]}}, "factors.start.position_m.7", "0 to 2"),
    ({"factors": {"rocks.cover": [0.1]}}, "dispersions.rocks.cover", "arms set rocks.cover"),
    ({"factors": {"": [1]}}, "factors", "must name a scenario key"),
    ({"arms": [{"name": "a"}]}, "arms", "combined with"),
    ({"factors": None, "arms": [{"name": "a"}, {"name": "a"}]}, "arms", "a name that differs"),
    ({"factors": None, "arms": []}, "arms", "each with a name"),
    ({"stop": {"metric": "sfe"}}, "stop.metric", "Did you mean 'safe'"),
    ({"stop": {}, "method": "latin-hypercube"}, "stop", "monte-carlo"),
    ({"correlations": {}}, "correlations", "each with keys"),
]
LAWLESS = [
    ({"kind": "normal", "mean": 0.05, "sigma": -0.01}, ".sigma", "must be positive"),
    ({"kind": "normal", "mean": 0.05, "sigma": float("nan")}, ".sigma", "finite"),
    ({"kind": "normal", "mean": 0.05}, ".sigma", "required for kind 'normal'"),
    ({"kind": "norm"}, ".kind", "Did you mean 'normal'"),
    ({"kind": "uniform", "low": 0.1, "high": 0.1}, ".low", "less than high"),
    ({"kind": "truncated-normal", "mean": 0.1, "sigma": 1.0}, ".low", "if high is omitted"),
    (
        {"kind": "truncated-normal", "mean": 0.0, "sigma": 1e-3, "low": 1.0},
        ".low",
        "must be closer to the mean",
    ),
    ({"kind": "choice", "values": []}, ".values", "at least one"),
    ({"kind": "choice", "values": [0.1], "weights": [0.0]}, ".weights", "positive"),
    (
        {"kind": "choice", "values": [0.1], "weights": [1.0, 2.0]},
        ".weights",
        "as many weights as values",
    ),
    ({"kind": "uniform", "low": -0.5, "high": 0.05}, "", "must be 0 or more"),
    (3.0, "", "table with a kind"),
]
MATRICES = [
    ([[1.0, 2.0], [2.0, 1.0]], "positive definite"),
    ([[1.0, 0.5], [0.4, 1.0]], "symmetric"),
    ([[2.0, 0.5], [0.5, 2.0]], "must be 1"),
    ([[1.0, 0.5]], "2 rows"),
    ([[1.0, float("nan")], [float("nan"), 1.0]], "finite"),
]


def test_a_scenario_by_name_or_by_a_file_beside_the_spec(tmp_path):
    """A file is the one meant where both are."""
    (tmp_path / "s.toml").write_text('scenario = "hirise"\nflights = 1\nseed = 1\n')
    by_name = CampaignSpec.load(tmp_path / "s.toml").scenario
    assert by_name.to_dict() == Scenario.load(SCENARIOS / "hirise.toml").to_dict()
    (tmp_path / "hirise").write_bytes((SCENARIOS / "mare.toml").read_bytes())
    mine = CampaignSpec.load(tmp_path / "s.toml").scenario
    assert mine.to_dict() == Scenario.load(SCENARIOS / "mare.toml").to_dict() != by_name.to_dict()


@pytest.mark.parametrize(("change", "field", "says"), BAD, ids=str)
def test_a_bad_spec_is_refused_by_name(change, field, says):
    with pytest.raises(InputError) as caught:
        spec(**change)
    assert caught.value.field == field and says in str(caught.value)


@pytest.mark.parametrize(("law", "field", "says"), LAWLESS, ids=str)
def test_dispersions_without_support_are_refused(law, field, says):
    with pytest.raises(InputError) as caught:
        spec(dispersions={"rocks.cover": law}, correlations=None)
    assert caught.value.field == f"dispersions.rocks.cover{field}"
    assert says in str(caught.value)


@pytest.mark.parametrize(("matrix", "says"), MATRICES, ids=str)
def test_correlations_that_are_none_are_refused(matrix, says):
    keys = ["start.position_m.0", "start.velocity_m_s.0"]
    with pytest.raises(InputError, match=r"correlations\.0\.matrix") as caught:
        spec(correlations=[{"keys": keys, "matrix": matrix}])
    assert says in str(caught.value)


def test_what_the_command_line_sweeps_over():
    assert parse_factors(["sun.elevation_deg=5,10,20.5", "rocks.cover=0.02:0.15:3",
                       "policy=safest,my.module:Own", "x=true"]) == {
        "sun.elevation_deg": [5, 10, 20.5], "rocks.cover": [0.02, 0.085, 0.15],
        "policy": ["safest", "my.module:Own"], "x": [True],
    }  # fmt: skip
    for text in ("a", "a=", "=1", "a=1,,2", "a=1:2:1", "a=2:1:3", "a=0:inf:3", "a=1:x:3"):
        with pytest.raises(InputError, match="--over"):
            parse_factors([text])
    with pytest.raises(InputError, match="each key only once"):
        parse_factors(["a=1", "a=2"])


def test_keys_of_a_swept_part_hold_for_the_kinds_that_are_swept():
    swept = {"guidance": ["fractional-polynomial"], "mappers.dem.kind": ["gaussian-dem"]}
    texts = ("rocks.cover=0.1", "guidance.gamma=1.5", "mappers.dem.cell_m=[1]", "policy=safest")
    assert split_changes(texts, swept) == (
        ("rocks.cover=0.1", "policy=safest"), {"guidance.gamma": 1.5, "mappers.dem.cell_m": [1]}
    )  # fmt: skip
    for text in ("guidance=apollo", "guidance.kind=apollo", "mappers.dem.kind=quadtree"):
        with pytest.raises(
            InputError, match=f"--set: must not set a key that --over sets, got '{text}'"
        ):
            split_changes([text], swept)
    with pytest.raises(InputError, match=r"--set: .*got 'a'"):
        split_changes(["a"], swept)


def run(*words: object):
    return CliRunner().invoke(main, [str(word) for word in words])


def test_plan_writes_inputs_and_flies_nothing(tmp_path):
    (tmp_path / "s.toml").write_text(TEXT)
    printed = run("campaign", "plan", tmp_path / "s.toml")
    assert printed.exit_code == 0, printed.output
    lines = printed.stdout.splitlines()
    assert len(lines) == 33 and lines[0].startswith("id,flight,arm,seed,policy.kind")
    for name, read in (("p.csv", pd.read_csv), ("p.parquet", pd.read_parquet)):
        assert run("campaign", "plan", tmp_path / "s.toml", "--out", tmp_path / name).exit_code == 0
        table = read(tmp_path / name)
        rows = list(build_plan(CampaignSpec.load(tmp_path / "s.toml")).rows())
        assert table.to_dict("records") == rows


def test_bad_requests_end_with_code_2_and_write_nothing(tmp_path):
    path, out = tmp_path / "s.toml", tmp_path / "out"
    path.write_text(TEXT.replace("golombek.toml", "none.toml"))
    tiny = SCENARIOS / "golombek.toml"
    for words in (
        ["campaign", "run", path, "--out", out],
        ["campaign", "run", tmp_path / "none.toml", "--out", out],
        ["campaign", "run", SCENARIOS / "golombek.toml", "--out", out],
        ["campaign", "plan", path, "--out", tmp_path / "p.txt"],
        ["campaign", "status", tmp_path],
        ["campaign", "export", tmp_path, "--out", tmp_path / "x.csv"],
        ["replay", tmp_path, "--flight", "0-0"],
        ["sweep", tiny, "--over", "rocks.covr=1,2", "--out", out],
        ["sweep", tiny, "--over", "start.position_m.2=-5,-6", "--out", out],
        ["sweep", tiny, "--over", "rocks.cover=0.1", "--flights", 0, "--out", out],
    ):
        done = run(*words)
        assert done.exit_code == 2, (words, done.output)
        assert "rror" in done.output and "Traceback" not in done.output
    assert [p.name for p in Path(tmp_path).iterdir()] == ["s.toml"]


def test_files_that_a_spec_names_are_found_from_its_folder(tmp_path, monkeypatch):
    """Wherever it is read from, and as it is kept with its results."""
    (tmp_path / "specs").mkdir()
    for name in ("a", "b"):
        made = (SCENARIOS / "data" / "hirise_dteec_010228_1490_crop.tif").read_bytes()
        (tmp_path / "specs" / f"{name}.tif").write_bytes(made)
    tables = {
        "factors": 'factors."terrain.path" = ["a.tif", "b.tif"]\n',
        "arms": '[[arms]]\nname = "a"\nset = { terrain = { path = "a.tif" } }\n'
                '[[arms]]\nname = "b"\nset = { "terrain.path" = "b.tif" }\n',
        "dispersions": 'dispersions."terrain.path" = { kind = "choice", values = ["a.tif"] }\n',
    }  # fmt: skip
    monkeypatch.chdir("/")
    for kind, text in tables.items():
        (tmp_path / "specs" / "s.toml").write_text(f'scenario = "hirise"\nflights = 2\n{text}')
        study = CampaignSpec.load(tmp_path / "specs" / "s.toml")
        names = [arm.name for arm in study.arms]
        assert names == {"factors": ["a.tif", "b.tif"], "arms": ["a", "b"]}.get(kind, ["all"])
        for i in range(len(study.arms)):
            path = study.scenario_of(1, i).to_dict()["terrain"]["path"]
            assert path == str(tmp_path / "specs" / f"{'ab'[i]}.tif")
        (tmp_path / "kept.toml").write_text(study.to_toml())
        kept = CampaignSpec.load(tmp_path / "kept.toml")
        assert kept.to_dict() == study.to_dict()
        assert [arm.name for arm in kept.arms] == names
