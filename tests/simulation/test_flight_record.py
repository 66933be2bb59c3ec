"""The record: what was saved comes back, and judgements and figures need nothing else."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.evaluation.flight_metrics import evaluate, initial_aim_point
from lunarsim.onboard.policies import Decision
from lunarsim.rng import flight_seed
from lunarsim.simulation import Flight, Simulation
from lunarsim.simulation.worlds import rebuild_world
from lunarsim.viz import draw_flight
from lunarsim.world.truth import TerrainTruth
from tests.flight_comparison import assert_same


@pytest.fixture(scope="module")
def flown():
    from lunarsim.scenario import Scenario

    scenario = Scenario.from_dict(
        {
            "name": "record",
            "terrain": {"size_m": 80.0},
            "rocks": {"cover": 0.05, "min_diameter_m": 0.3},
            "target": {"scatter_m": [15.0, 15.0]},
            "mappers": {"dem": {"kind": "gaussian-dem", "posting_m": 0.5, "size_m": 50.0}},
        }
    )
    simulation = Simulation(scenario, flight_seed(3, 1), "safest")
    return simulation, simulation.run()


def test_a_flight_comes_back_to_the_last_bit(flown, tmp_path):
    _, flight = flown
    again = Flight.load(flight.save(tmp_path / "flight"))
    before, after = asdict(flight), asdict(again)
    for record in (before, after):
        # The covariance of the first map's estimate is not kept.
        record["first_map"].pop("covariance")
    assert_same(before, after)
    assert_same(
        asdict(Flight.load(again.save(tmp_path / "twice")))["trajectory"], after["trajectory"]
    )


def test_a_flight_saved_over_another_leaves_nothing_of_it(flown, tmp_path):
    _, flight = flown
    folder = flight.save(tmp_path / "flight")
    (folder / "maps" / "dem.rocks.parquet").write_bytes(
        (folder / "candidates.parquet").read_bytes()
    )
    assert Flight.load(flight.save(folder)).maps["dem"].tables == {}


def test_time_to_go_ends_at_nothing(flown):
    _, flight = flown
    assert flight.trajectory["time_to_go"].min() == 0.0


def test_judgement_and_figures_need_the_record_alone(flown, tmp_path):
    simulation, flight = flown
    loaded = Flight.load(flight.save(tmp_path / "flight"))
    world = rebuild_world(loaded)
    assert np.array_equal(world.terrain.rocks.x, simulation.world.terrain.rocks.x)
    truth = TerrainTruth.of(world, simulation.lander)
    row = evaluate(loaded, truth)
    assert_same(row, evaluate(flight, simulation.truth))
    assert row["map_true_safe"] > 1000
    draw_flight(loaded, world, truth, tmp_path / "figures")
    assert {f.name for f in (tmp_path / "figures").iterdir()} == {
        "descent.png", "maps.png", "touchdown.png",
    }  # fmt: skip


def test_extremes_and_errors_are_those_of_the_trajectory(flown):
    """Each value from the record by SciPy's rotations and one cycle at a time."""
    simulation, flight = flown
    row, t, lander = evaluate(flight, simulation.truth), flight.trajectory, simulation.lander
    touchdown = flight.outcome.touchdown
    tilts, rates, throttles, speed = [], [], [], None
    for n in range(len(t["time"])):
        attitude = Rotation.from_quat([t[f"attitude_{a}"][n] for a in "xyzw"])
        tilts.append(np.degrees(np.arccos(attitude.apply([0.0, 0.0, 1.0])[2])))
        rates.append(np.degrees(np.linalg.norm([t[f"rate_{a}"][n] for a in "xyz"])))
        throttles.append(
            (t["thrust"][n] - lander.thrust_min) / (lander.thrust_max - lander.thrust_min)
        )
        pads = t["position_z"][n] - lander.com_height - touchdown.position[2]
        if speed is None and pads <= 10.0:
            speed = np.hypot(t["velocity_x"][n], t["velocity_y"][n])
    assert row["max_tilt_deg"] == pytest.approx(max(tilts), abs=1e-6)
    assert row["max_rate_deg_s"] == pytest.approx(max(rates))
    assert row["lower_throttle_margin"] == pytest.approx(min(throttles))
    assert row["upper_throttle_margin"] == pytest.approx(1.0 - max(throttles))
    assert row["horizontal_speed_at_10m_m_s"] == pytest.approx(speed)
    # The site is known on the map, whose error is that of navigation when it was made.
    aimed = simulation.site[:2] - flight.map_error[:2]
    assert row["miss_m"] == pytest.approx(np.hypot(*(touchdown.position[:2] - aimed)))
    error = simulation.navigation_error
    # The lander is near its site by its own estimate, which has drifted since the map was made.
    drift = np.hypot(*(error - flight.map_error)[:2])
    assert row["miss_m"] > 0.0 and abs(row["miss_m"] - drift) < 1.0
    assert row["navigation_error_m"] == pytest.approx(np.hypot(error[0], error[1]), abs=0.05)


def test_a_divert_in_the_first_cycle_counts(small_scenario):
    scenario = small_scenario.changed(decisions={"first_altitude_m": 2000.0})
    simulation = Simulation(scenario, 2, None)
    first = simulation.site.copy()
    assert simulation.decision_due
    assert simulation.apply(Decision(first + [20.0, -15.0, 0.0], "at once"))
    simulation.move()
    flight = simulation.run()
    assert flight.decisions[0]["time"] == 0.0
    assert flight.divert_distance == pytest.approx(25.0)
    assert flight.sites[0] == pytest.approx(first)
    assert flight.sites[1] == pytest.approx(first + [20.0, -15.0, 0.0])
    # The first aim is where the lander would have come down without a divert.
    error = flight.trajectory["estimated_x"][0] - flight.trajectory["position_x"][0]
    assert initial_aim_point(flight)[0] == pytest.approx(first[0] - error)
    assert flight.target == pytest.approx(first)


@pytest.mark.parametrize("altitude", [150.0, 380.0])
def test_a_start_within_the_decision_window_is_evaluated_by_where_it_aimed(
    small_scenario, altitude
):
    """The oracle diverts in the first cycle; figures are those of the site that it left."""
    start = {"position_m": [-0.6 * altitude, 0.0, altitude], "velocity_m_s": [10.0, 0.0, -8.0]}
    scenario = small_scenario.changed(start=start, rocks={"cover": 0.15})
    for seed in range(1, 9):
        simulation = Simulation(scenario, flight_seed(seed, 0), "truth-oracle")
        aimed = simulation.site - simulation.navigation_error
        if not simulation.truth.is_safe_at(aimed[:2]):
            break
    flight = simulation.run()
    row = evaluate(flight, simulation.truth)
    assert flight.decisions[0]["time"] == 0.0
    assert initial_aim_point(flight) == pytest.approx(aimed[:2])
    assert row["target_exactly_safe"] is False
    assert flight.outcome.touchdown is not None
    flown = np.hypot(*(flight.outcome.touchdown.position[:2] - aimed[:2]))
    assert row["divert_m"] > 1.0
    assert row["divert_m"] == pytest.approx(flown, abs=1.0)


def test_no_setting_of_a_mapper_changes_the_yardstick(small_scenario):
    coarse = small_scenario.changed(mappers={"dem": {"posting_m": 0.8}})
    a, b = (Simulation(s, flight_seed(3, 0)) for s in (small_scenario, coarse))
    assert a.truth.grid == b.truth.grid
    square = (-5.0, 5.0, -5.0, 5.0)
    assert np.array_equal(a.truth.within(square).safe, b.truth.within(square).safe)


def test_what_is_no_flight_is_refused(flown, tmp_path):
    with pytest.raises(InputError, match=r"flight\.json"):
        Flight.load(tmp_path)
    folder = flown[1].save(tmp_path / "broken")
    (folder / "scans.parquet").unlink()
    with pytest.raises(InputError, match=r"intact file of a flight record \(no such file"):
        Flight.load(folder)
    (folder / "flight.json").write_text("{")
    with pytest.raises(InputError, match="intact file of a flight record"):
        Flight.load(folder)


def test_a_record_without_a_column_was_written_by_another_version(flown, tmp_path):
    folder = flown[1].save(tmp_path / "flight")
    file, record = folder / "trajectory.parquet", folder / "flight.json"
    pq.write_table(pq.read_table(file).drop_columns("thrust"), file)
    tables = json.loads(record.read_text(encoding="utf-8"))
    tables["digests"][file.name] = hashlib.sha256(file.read_bytes()).hexdigest()
    record.write_text(json.dumps(tables), encoding="utf-8")
    with pytest.raises(InputError, match=r"has no column thrust: another version"):
        Flight.load(folder)


def test_files_say_in_which_frame_positions_are(flown, tmp_path):
    folder = flown[1].save(tmp_path / "framed")
    told = json.loads((folder / "flight.json").read_text())["frames"]
    assert any("decisions" in what and "local" in frame for what, frame in told.items())
    assert any("target" in what and "true" in frame for what, frame in told.items())
    for name in ("scans", "candidates"):
        metadata = pq.read_schema(folder / f"{name}.parquet").metadata
        assert metadata[b"frame:x"].startswith(b"local ENU")
    columns = pq.read_schema(folder / "trajectory.parquet").metadata
    assert columns[b"frame:position_x"].startswith(b"true")
    assert columns[b"frame:site_x"].startswith(b"local")
