"""Plots of a report that show single flights: speeds, attitudes, trajectories, propellant."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from lunarsim.campaign.analysis import differences
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.report.flight_data import recorded_paths, touchdown_axes
from lunarsim.campaign.report.page import template_variables
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import run as fly
from lunarsim.cli import main
from lunarsim.scenario import Scenario
from tests.campaign.surrogate import plan
from tests.worlds import TINY_FLIGHT

SPEC = """
name = "tiny"
scenario = "tiny.toml"
flights = 3
seed = 5
records = "all"

[dispersions]
"sun.elevation_deg" = {{ kind = "uniform", low = 5.0, high = 20.0 }}

[[arms]]
name = "safest"
set = {{ policy = "safest" }}

[[arms]]
name = "e-guidance"
set = {{ policy = "safest", guidance = {{ kind = "e-guidance" }}{more} }}
"""


def flown(folder, more=""):
    Scenario.from_dict(TINY_FLIGHT).changed(rocks={"cover": 0.12}).save(folder / "tiny.toml")
    (folder / "spec.toml").write_text(SPEC.format(more=more))
    done = CliRunner().invoke(
        main, ["campaign", "run", str(folder / "spec.toml"), "--out", str(folder / "out"),
               "--jobs", "1", "--cache-size", "0"],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    return load_results(folder / "out")


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return flown(tmp_path_factory.mktemp("report"))


@pytest.fixture(scope="module")
def variables(results):
    return template_variables(results)


def test_propellant_is_compared_flight_by_flight(results, variables):
    table = results.table.to_pandas()
    used = table.pivot(index="flight", columns="arm", values="propellant_kg")
    mean = (used["e-guidance"] - used["safest"]).mean()
    (found,) = differences(results, "propellant_kg")
    (trace,) = variables["plots"]["propellant-differences"]["data"]
    assert trace["x"] == [found.value] == [pytest.approx(mean)]
    error = trace["error_x"]
    assert mean - error["arrayminus"][0] == pytest.approx(found.low) and found.low < mean
    assert mean + error["array"][0] == pytest.approx(found.high) and found.high > mean
    (row,) = variables["difference_tables"]["propellant-differences"]["rows"]
    assert row["cells"][:2] == ["e-guidance − safest", 3]
    assert row["cells"][2] == f"{mean:+.2f} [{found.low:+.2f}, {found.high:+.2f}]"


def test_touchdowns_are_drawn_with_the_limits_of_the_lander(results, variables):
    lander = Scenario.from_dict(TINY_FLIGHT).true_lander()
    table = results.table.to_pandas()
    for name, (x, x_limit), (y, y_limit) in (
        ("touchdown-speed", ("horizontal_speed_m_s", lander.horizontal_speed_limit),
         ("vertical_speed_m_s", lander.vertical_speed_limit)),
        ("touchdown-tilt", ("slope_deg", np.rad2deg(lander.slope_limit)),
         ("tilt_deg", np.rad2deg(lander.tilt_limit))),
    ):  # fmt: skip
        plot = variables["plots"][name]
        across, along = plot["layout"]["shapes"]
        assert across["x0"] == across["x1"] == pytest.approx(x_limit)
        assert along["y0"] == along["y1"] == pytest.approx(y_limit)
        assert along["xref"] == across["yref"] == "paper"
        for axis, metric, limit in (("x", x, x_limit), ("y", y, y_limit)):
            drawn = np.concatenate([trace[axis] for trace in plot["data"]])
            assert sorted(drawn) == pytest.approx(sorted(table[metric].dropna()), abs=1e-4)
            layout = plot["layout"][f"{axis}axis"]
            assert layout["range"][1] > max(limit, drawn.max())
            assert layout["title"]["text"].endswith(("(m/s)", "(deg)"))


def test_no_limit_is_drawn_that_is_not_that_of_all_flights(tmp_path):
    results = flown(tmp_path, ', "vehicle.tilt_limit_deg" = 3.0')
    axes, remark = touchdown_axes(results)
    assert all(axis.limit is None for pair in axes for axis in pair)
    assert "differ between flights" in remark
    plot = template_variables(results)["plots"]["touchdown-tilt"]
    assert plot["layout"]["shapes"] == [] and remark in plot["caption"]


def test_trajectories_are_those_of_the_records(results, variables):
    paths = recorded_paths(results)
    assert len(paths) == len(results.table) == 6
    drawn = variables["plots"]["trajectories"]["data"]
    assert sum(trace["x"].count(None) for trace in drawn) == 6
    table = pd.read_parquet(
        results.folder / "flights" / "e-guidance" / "00001" / "trajectory.parquet"
    )
    end = table.iloc[-1]
    distance = np.hypot(
        table["position_x"] - end["position_x"], table["position_y"] - end["position_y"]
    )
    path = [p for p in paths if p.arm == "e-guidance"][1]
    assert path.distance[0] == distance[0] and path.height[-1] == path.distance[-1] == 0.0
    assert set(path.distance) <= set(distance)


def test_no_sensitivity_is_drawn_without_indices(results, variables):
    """Three flights are too few: the report states it and draws no empty chart."""
    assert "sensitivity" not in variables["plots"] and variables["sensitive"] == []
    assert "No indices: safest: " in variables["no_sensitivity"]


def test_a_campaign_without_records_dispersions_and_touchdowns_has_no_such_plot(tmp_path):
    fly(plan(flights=4), InlineEngine(), tmp_path / "c")
    made = template_variables(load_results(tmp_path / "c"))
    assert not {"trajectories", "touchdown-speed", "touchdown-tilt", "sensitivity",
                "propellant-differences"} & set(made["plots"])  # fmt: skip
    assert "differences" in made["plots"]
    assert made["no_sensitivity"] == ""
