"""Guidance along a reference trajectory: how well it tracks, and which files it refuses."""

from __future__ import annotations

import os
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from lunarsim.errors import InputError
from lunarsim.exports import ExportOptions, export_flight
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.contract import PhaseEnd, PlansArrival
from lunarsim.onboard.guidance.trajectory_law import TrajectoryLaw
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies import Decision
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.worlds import TINY_FLIGHT

G = 1.622
# Without errors of navigation, what is left is the error of tracking.
EXACT = Scenario.from_dict(TINY_FLIGHT).changed(
    sensors={
        "fix": {
            "position_bias_m": 0.0, "position_drift_m": 0.0, "velocity_m_s": 0.0,
            "attitude_deg": 0.0,
        }
    }
)  # fmt: skip


def fly(scenario, policy="no-divert"):
    return Simulation(scenario, flight_seed(1, 0), policy).run()


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """Return a flight, and the folder with its trajectory as OEM and as CSV."""
    folder, flight = tmp_path_factory.mktemp("reference"), fly(EXACT)
    export_flight(flight, "oem", folder / "a.oem")
    export_flight(flight, "csv", folder / "tables")
    return flight, folder


def tracking(path, scenario=EXACT, **keys):
    return scenario.changed(guidance={"kind": "trajectory", "path": str(path)} | keys)


def distances(flight, reference):
    """Return distances from the reference at the same times during the approach, m."""
    time = flight.trajectory["time"]
    r = np.column_stack([np.interp(time, reference.trajectory["time"], p)
                         for p in reference.positions.T])  # fmt: skip
    approach = flight.trajectory["phase"] == 0
    return np.linalg.norm(flight.positions - r, axis=1)[approach]


@pytest.mark.parametrize("name", ["a.oem", "tables/trajectory.csv"])
def test_an_exported_flight_is_flown_again(reference, name):
    first, folder = reference
    again = fly(tracking(folder / name))
    error = distances(again, first)
    assert error.max() < 2.0 and np.median(error) < 0.7
    assert again.outcome.safe and first.outcome.safe
    apart = again.outcome.touchdown.position - first.outcome.touchdown.position
    assert np.linalg.norm(apart[:2]) < 0.2
    assert abs(again.duration - first.duration) < 1.0
    assert not [e for e in again.events if e["name"] == "guidance-fallback"]


def test_other_epochs_change_nothing(reference, tmp_path):
    first, folder = reference
    options = ExportOptions(epoch="2031-12-31T23:59:50")
    export_flight(first, "oem", tmp_path / "b.oem", options)
    one, other = TrajectoryLaw(path=folder / "a.oem"), TrajectoryLaw(path=tmp_path / "b.oem")
    np.testing.assert_allclose(one.reference().time, other.reference().time, atol=1e-9)
    np.testing.assert_array_equal(one.reference().position, other.reference().position)


def test_days_of_the_year_are_dates(reference, tmp_path):
    first, folder = reference
    export_flight(first, "oem", tmp_path / "b.oem", ExportOptions(epoch="2028-02-29T23:59:50"))
    text = (tmp_path / "b.oem").read_text()
    assert "2028-03-01T" in text
    text = text.replace("2028-02-29T", "2028-060T").replace("2028-03-01T", "2028-061T")
    (tmp_path / "b.oem").write_text(text)
    one, other = TrajectoryLaw(path=folder / "a.oem"), TrajectoryLaw(path=tmp_path / "b.oem")
    np.testing.assert_allclose(one.reference().time, other.reference().time, atol=1e-9)


def test_comment_lines_of_a_csv_file_are_ignored(tmp_path):
    text = straight(tmp_path).read_text()
    first, *rest = text.splitlines()
    (tmp_path / "b.csv").write_text("\n".join(["# made by hand", first, "# states", *rest]))
    one, other = (TrajectoryLaw(path=tmp_path / n).reference() for n in ("line.csv", "b.csv"))
    np.testing.assert_array_equal(one.position, other.position)


def test_a_reference_of_the_estimate_with_covariance_is_read(reference, tmp_path):
    first, _ = reference
    export_flight(first, "oem", tmp_path / "b.oem", ExportOptions(state="estimate"))
    found = TrajectoryLaw(path=tmp_path / "b.oem").reference()
    assert len(found.time) == len(first.navigation["time"])


def test_a_reference_with_coarse_times_is_tracked(reference, tmp_path):
    """A state each 2 s: the interpolation fills in."""
    first, folder = reference
    table = pd.read_csv(folder / "tables" / "trajectory.csv")
    rows = np.r_[0 : len(table) - 1 : 10, len(table) - 1]
    table.iloc[rows].to_csv(tmp_path / "coarse.csv", index=False)
    again = fly(tracking(tmp_path / "coarse.csv"))
    assert again.outcome.safe and distances(again, first).max() < 2.5


def test_start_errors_decay(reference, tmp_path):
    """A start that is 8 m off reaches the reference."""
    first, folder = reference
    moved = EXACT.changed(start={"position_m": [-600.0, 8.0, 500.0], "position_sigma_m": 0.0})
    again = fly(tracking(folder / "a.oem", moved))
    error = distances(again, first)
    assert error[0] > 8.0 and error[-20:].max() < 1.0 and again.outcome.safe


def test_a_divert_leaves_the_reference(reference):
    _, folder = reference

    class GoEast:
        name = "go-east"

        def decide(self, observation):
            if self.gone:
                return Decision.keep("there")
            self.gone = True
            return Decision(observation.site + [6.0, 0.0, 0.0], "east")

        gone = False

    again = fly(tracking(folder / "a.oem"), GoEast())
    assert [e["reason"] for e in again.events if e["name"] == "guidance-fallback"] == ["divert"]
    miss = again.outcome.touchdown.position[:2] - (again.target[:2] + [6.0, 0.0])
    assert np.linalg.norm(miss) < 1.0 and again.outcome.safe


# --- the law alone --------------------------------------------------------------------------------


def straight(
    folder, name="line.csv", scale=1.0, end=(0.0, 0.0, 0.0), n=41, start=(0.0, 0.0, 400.0)
):
    """Write a reference with constant acceleration that ends at rest."""
    time = np.linspace(0.0, 40.0, n)
    start, end = np.array(start), np.array(end)
    share = (1.0 - time / 40.0)[:, None]
    position = end + (start - end) * share**2
    velocity = -(start - end) * share / 20.0
    table = np.column_stack((time, position, scale * velocity))
    heads = [
        "time (s)",
        *(f"position_{a} (m)" for a in "xyz"),
        *(f"velocity_{a} (m/s)" for a in "xyz"),
    ]
    pd.DataFrame(table, columns=heads).to_csv(folder / name, index=False)
    return folder / name


def briefing(start=(0.0, 0.0, 400.0), velocity=(0.0, 0.0, -20.0), target=(0.0, 0.0, 0.0)):
    return SimpleNamespace(
        start=SimpleNamespace(position=np.array(start), velocity=np.array(velocity)),
        target=np.array(target), lander=Lander(), surface_gravity=G, nonuniform_gravity=None,
        software=SimpleNamespace(approach=Approach()),
    )  # fmt: skip


def estimate(position, velocity):
    return Estimate(
        0.0, np.array(position), np.array(velocity), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3),
        1500.0, np.eye(9),
    )  # fmt: skip


def end_of(target=(0.0, 0.0, 0.0)):
    return Approach().end(np.array(target), Lander())


def test_the_command_is_feedforward_and_feedback(tmp_path):
    law = TrajectoryLaw(path=straight(tmp_path), time_constant=4.0, damping=0.5)
    guidance = law.build(briefing(), 0.0)
    assert isinstance(guidance, PlansArrival)
    # At 10 s the reference is at 225 m, with -15 m/s and 0.5 m/s^2.
    exact = guidance.command(estimate((0.0, 0.0, 225.0), (0.0, 0.0, -15.0)), end_of(), 10.0, 30.0)
    np.testing.assert_allclose(exact, [0.0, 0.0, 0.5 + G], atol=1e-9)
    off = guidance.command(estimate((3.0, -2.0, 226.0), (0.4, 0.0, -15.2)), end_of(), 10.0, 30.0)
    expected = [-3.0 / 16 - 0.25 * 0.4, 2.0 / 16, 0.5 + G - 1.0 / 16 + 0.25 * 0.2]
    np.testing.assert_allclose(off, expected, atol=1e-9)
    height = end_of().position[2]
    assert guidance.arrival == pytest.approx(40.0 * (1.0 - np.sqrt(height / 400.0)), abs=0.05)


def test_the_reference_moves_with_the_site(tmp_path):
    guidance = TrajectoryLaw(path=straight(tmp_path)).build(briefing(), 0.0)
    moved = end_of((0.4, -0.3, 0.2))
    found = guidance.command(estimate((0.4, -0.3, 225.2), (0.0, 0.0, -15.0)), moved, 10.0, 30.0)
    np.testing.assert_allclose(found, [0.0, 0.0, 0.5 + G], atol=1e-9)


def test_after_a_hover_and_after_the_reference_the_apollo_law_flies(tmp_path):
    law = TrajectoryLaw(path=straight(tmp_path))
    state = estimate((0.0, 0.0, 225.0), (0.0, 0.0, -15.0))
    guidance = law.build(briefing(), 0.0)
    guidance.command(state, end_of(), 10.0, 30.0)
    guidance.arrival = None
    guidance.command(state, end_of(), 10.1, 30.0)
    assert guidance.events == [(10.1, "guidance-fallback", {"reason": "new approach"})]
    assert np.isfinite(guidance.arrival)
    guidance = law.build(briefing(), 0.0)
    guidance.command(state, end_of(), 10.0, 30.0)
    wanted = guidance.command(state, end_of(), 41.0, 30.0)
    assert guidance.events[0][2] == {"reason": "end of the reference"}
    assert np.isfinite(wanted).all()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"start": (60.0, 0.0, 400.0)}, "begin at the start state.*position differs by 60 m"),
        ({"velocity": (0.0, 6.0, -20.0)}, "begin at the start state.*velocity differs by 6 m/s"),
        ({"target": (0.0, 11.0, 0.0)}, "end at the target.*is 11 m away"),
        ({"target": (0.0, 0.0, 30.0)}, "end at the target.*is 30 m away"),
        ({"target": (0.0, 0.0, -40.0)}, "end at the target.*m away"),
    ],
)
def test_a_reference_must_fit_the_mission(tmp_path, given, words):
    law = TrajectoryLaw(path=straight(tmp_path))
    with pytest.raises(InputError, match=f"path: must {words}"):
        law.build(briefing(**given), 0.0)


def test_a_flight_names_the_key(reference):
    _, folder = reference
    away = EXACT.changed(target={"position_m": [9.0, 9.0], "scatter_m": [0.0, 0.0]})
    with pytest.raises(InputError, match=r"^guidance\.path: must begin at the start state|end at"):
        fly(tracking(folder / "a.oem", away))


HEAD = "time (s)," + ",".join(f"position_{a} (m)" for a in "xyz")
HEAD += "," + ",".join(f"velocity_{a} (m/s)" for a in "xyz") + "\n"
FIRST, LAST = "0,0,0,400,0,0,-20\n", "1,0,0,380.5,0,0,-19\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"no column 'time \(s\)'"),
        (HEAD.replace("velocity_z (m/s)", "vz") + FIRST + LAST, r"no column 'velocity_z \(m/s\)'"),
        (HEAD.replace("_x (m)", "_x (km)") + FIRST + LAST, "has the unit 'km', not 'm'"),
        (HEAD, "at least two states"),
        (HEAD + FIRST, "at least two states"),
        (HEAD + FIRST + "0,0,0,380.5,0,0,-19\n", "strictly increasing times"),
        (HEAD + FIRST + LAST + FIRST, r"strictly increasing times.*\(state 3\)"),
        ("# from a flight\n\n" + HEAD + FIRST + "# end\n1,0,0,x,0,0,-19\n", "line 6 has a value"),
        (HEAD + FIRST + "1,0,0,nan,0,0,-19\n", "finite numbers"),
        (HEAD + FIRST + "inf,0,0,1,0,0,-19\n", "finite numbers"),
        (HEAD + FIRST + "1,0,0,x,0,0,-19\n", "line 3 has a value that is not a number"),
        (
            HEAD + FIRST.replace("0,0", "5,0", 1) + LAST.replace("1", "6", 1),
            "begin at the time 0 s",
        ),
    ],
)
def test_bad_csv_files_are_refused(tmp_path, text, words):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=f"^path: .*{words}"):
        TrajectoryLaw(path=tmp_path / "a.csv")


def test_wrong_units_of_the_velocity_are_found(tmp_path):
    for scale in (1e-3, 3.6, -1.0):
        with pytest.raises(InputError, match="follow from the velocities"):
            TrajectoryLaw(path=straight(tmp_path, scale=scale))


def test_exchanged_columns_are_found(reference, tmp_path):
    table = pd.read_csv(reference[1] / "tables" / "trajectory.csv")
    names = {"velocity_x (m/s)": "velocity_y (m/s)", "velocity_y (m/s)": "velocity_x (m/s)"}
    table.rename(columns=names).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(InputError, match="follow from the velocities"):
        TrajectoryLaw(path=tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("CCSDS_OEM_VERS", "CCSDS_OPM_VERS", "does not begin with CCSDS_OEM_VERS"),
        ("REF_FRAME = LUNARSIM_SITE_ENU", "REF_FRAME = EME2000", "REF_FRAME is 'EME2000'"),
        ("REF_FRAME = LUNARSIM_SITE_ENU\n", "", "do not state REF_FRAME"),
        ("CENTER_NAME = MOON\n", "", "do not state CENTER_NAME"),
        ("2000-01-01T12:00:01.", "2001-366T12:00:01.", "the year 2001 has no day 366"),
        ("2000-01-01T12:00:01.", "2000-000T12:00:01.", "the year 2000 has no day 000"),
        ("CENTER_NAME = MOON", "CENTER_NAME = EARTH", "CENTER_NAME is 'EARTH'"),
        ("12:00:01.", "12:00:00.", "strictly increasing times"),
        (
            "2000-01-01T12:00:01.000000000 ",
            "2000-01-01T12:00:01.000000000 1.0 ",
            "has 7 numbers instead of 6 or 9",
        ),
        (
            "2000-01-01T12:00:01.000000000 ",
            "2000-13-01T12:00:01.000000000 ",
            "because Month out of range",
        ),
        ("2000-01-01T12:00:01.000000000 ", "yesterday ", "is not a state"),
        ("e-01 ", "e+99 ", "follow from the velocities"),
        ("e-01 ", "e+999 ", "finite numbers"),
    ],
)
def test_bad_oem_files_are_refused(reference, tmp_path, old, new, words):
    text = (reference[1] / "a.oem").read_text()
    assert old in text
    (tmp_path / "a.oem").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=f"^path: .*({words})"):
        TrajectoryLaw(path=tmp_path / "a.oem")


def test_two_segments_are_refused(reference, tmp_path):
    text = (reference[1] / "a.oem").read_text()
    (tmp_path / "a.oem").write_text(text + text[text.index("META_START") :])
    with pytest.raises(InputError, match="more than one segment"):
        TrajectoryLaw(path=tmp_path / "a.oem")


def test_files_of_strangers(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe.oem")
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "a.txt").write_text("")
    straight(tmp_path)
    monkeypatch.setattr("lunarsim.csv_columns.MAX_BYTES", 1000)
    for name, words in (
        ("gone.oem", "existing file"), ("pipe.oem", "existing file"),
        ("a.txt", "ends in .oem or .csv"), ("bytes.csv", "not text in UTF-8"),
        ("line.csv", "is larger than"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            TrajectoryLaw(path=tmp_path / name)


def test_the_path_is_required_and_relative_to_the_scenario(reference, tmp_path):
    with pytest.raises(InputError, match=r"guidance\.path: is required"):
        Scenario.from_dict({"guidance": {"kind": "trajectory"}})
    (tmp_path / "a.oem").write_bytes((reference[1] / "a.oem").read_bytes())
    (tmp_path / "a.toml").write_text('[guidance]\nkind = "trajectory"\npath = "a.oem"\n')
    assert Scenario.load(tmp_path / "a.toml").guidance.path == tmp_path / "a.oem"


def test_a_bad_end_is_refused(tmp_path):
    guidance = TrajectoryLaw(path=straight(tmp_path)).build(briefing(), 0.0)
    with pytest.raises(InputError, match="finite"):
        guidance.command(estimate((0.0, 0.0, np.nan), (0.0, 0.0, 0.0)), end_of(), 0.0, 40.0)
    with pytest.raises(InputError, match="finite"):
        wrong = PhaseEnd(np.array([0.0, np.nan, 0.0]))
        guidance.command(estimate((0.0, 0.0, 400.0), (0.0, 0.0, -20.0)), wrong, 0.0, 40.0)
