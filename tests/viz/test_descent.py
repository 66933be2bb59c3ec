"""The picture of the descent: its lines are the record's figures, each with a name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.frames import quat_to_matrix
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.viz import descent
from tests.worlds import TINY_FLIGHT


@pytest.fixture(scope="module")
def flown():
    """Return a flight with a divert."""
    scenario = Scenario.from_dict(TINY_FLIGHT).changed(rocks={"cover": 0.1})
    for seed in range(1, 9):
        record = Simulation(scenario, flight_seed(seed, 0), "safest").run()
        if record.decisions:
            break
    return record


@pytest.fixture
def axes(flown, monkeypatch, tmp_path):
    """Return the axes of the picture by what their vertical axis says; events under theirs."""
    kept = []
    monkeypatch.setattr(descent, "save", lambda figure, path: kept.append(figure))
    descent.draw_descent(flown, tmp_path / "descent.png")
    return {axes.get_ylabel().partition(" (")[0] or "events": axes for axes in kept[0].axes}


def _line(axes, name):
    (found,) = [line for line in axes.lines if line.get_label() == name]
    return found.get_data()


def test_lines_hold_the_record_in_the_units_of_their_axes(flown, axes):
    t, lander = flown.trajectory, Scenario.from_toml(flown.scenario).vehicle.make()
    q = np.column_stack([t[f"attitude_{a}"] for a in "xyzw"])
    for axis, name, values in (
        ("Speed", "descent rate", -t["velocity_z"]),
        ("Speed", "horizontal speed", np.hypot(t["velocity_x"], t["velocity_y"])),
        ("Tilt", "tilt from the vertical", np.rad2deg(np.arccos(quat_to_matrix(q)[:, 2, 2]))),
        ("Thrust", "thrust", t["thrust"] / 1e3),
        ("Propellant", "remaining propellant", t["mass"] - lander.dry_mass),
    ):
        time, drawn = _line(axes[axis], name)
        assert np.array_equal(time, t["time"])
        assert drawn == pytest.approx(values, abs=1e-9), name
    level = [line.get_ydata() for line in axes["Thrust"].lines if line.get_linestyle() == "--"]
    assert [y[0] for y in level if len(y)] == [lander.thrust_min / 1e3, lander.thrust_max / 1e3]


def test_the_profile_ends_at_the_touchdown(flown, axes):
    profile = axes["Altitude above touchdown"]
    away, altitude = profile.lines[0].get_data()
    assert away[-1] == altitude[-1] == 0.0
    assert altitude[0] == flown.positions[0, 2] - flown.positions[-1, 2]
    named = {text.get_text() for text in profile.get_legend().get_texts()}
    assert {"path", "LiDAR scan", "divert", "touchdown"} == named


def test_a_lost_navigation_is_marked_where_it_begins(flown, monkeypatch, tmp_path):
    lost = np.zeros(len(flown.trajectory["time"]), int)
    lost[20:25] = lost[40:] = 1
    kept = []
    monkeypatch.setattr(descent, "save", lambda figure, path: kept.append(figure))
    descent.draw_descent(
        replace(flown, trajectory=flown.trajectory | {"lost": lost}), tmp_path / "d.png"
    )
    (events,) = [a for a in kept[0].axes if "navigation lost" in
                 [label.get_text() for label in a.get_yticklabels()]]  # fmt: skip
    row = [label.get_text() for label in events.get_yticklabels()].index("navigation lost")
    (marks,) = [line for line in events.lines if len(line.get_ydata())
                and line.get_marker() == "X" and line.get_ydata()[0] == row]  # fmt: skip
    assert marks.get_xdata().tolist() == flown.trajectory["time"][[20, 40]].tolist()


def test_all_share_the_time_with_diverts_and_phases_marked(flown, axes):
    diverts = [d["time"] for d in flown.decisions]
    phase = flown.trajectory["phase"].astype(int)
    begins = flown.trajectory["time"][np.flatnonzero(np.diff(phase)) + 1]
    assert len(diverts) > 0 and len(begins) > 0
    for name in ("events", "Speed", "Tilt", "Thrust", "Propellant"):
        lines = [line.get_xdata() for line in axes[name].lines]
        upright = {x[0] for x in lines if len(x) == 2 and x[0] == x[1]}
        assert upright >= {*diverts, *begins}, name
        assert axes[name].get_xlim() == (0.0, flown.trajectory["time"][-1])
    rows = [text.get_text() for text in axes["events"].get_yticklabels()]
    marks = {name: line.get_xdata() for name, line in zip(rows, axes["events"].lines, strict=False)}
    scans = [e["time"] for e in flown.events if e["name"] == "scan"]
    assert list(marks["LiDAR scan"]) == scans
    assert list(marks["divert"]) == diverts


def test_every_line_has_a_name(axes):
    for name in ("Speed", "Tilt", "Thrust", "Propellant"):
        legend = {text.get_text() for text in axes[name].get_legend().get_texts()}
        drawn = [line for line in axes[name].lines if len(line.get_xdata()) > 2]
        assert {line.get_label() for line in drawn} <= legend
