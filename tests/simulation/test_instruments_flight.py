"""A lander that navigates by its own instruments, with no fixes and no map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.evaluation.consistency import Consistency, normalised_squared_error
from lunarsim.frames import (
    quat_to_matrix,
)
from lunarsim.messages.measurements import (
    AltimeterReading,
    DopplerReading,
    InertialSamples,
    Measurements,
)
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.chance import CHANCE, ratio_bounds, sample_sizes
from tests.conftest import SCENARIOS
from tests.navigation_errors import error_of


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """The scenario on a smaller piece of ground."""
    whole = Scenario.load(SCENARIOS / "instruments.toml")
    return whole.changed(
        terrain={"size_m": 240.0}, initial_uncertainty={"position_m": 15.0}, mappers={"dem": None},
        tasking={"flash": {"kind": "periodic", "rate_hz": 1.0}},
        sensors={"flash": {"rows": 32, "cols": 32}},
    )  # fmt: skip


def tampered(simulation: Simulation, kind: type, change, begins: float = 8.0) -> None:
    """Let measurements of a kind be wrong from a time on."""
    navigation = simulation.computer.navigation
    honest = navigation.take

    def take(sensor, measurement, time):
        wrong = isinstance(measurement, kind) and time >= begins
        honest(sensor, change(measurement) if wrong else measurement, time)

    navigation.take = take


def events(simulation: Simulation) -> list[str]:
    return [name for _, name, _ in simulation.computer.telemetry]


@pytest.mark.statistical
@sample_sizes(2, 6)
def test_it_has_the_stated_error_and_lands_at_its_estimate(scenario, count):
    nees = Consistency()
    for seed in range(count):
        simulation = Simulation(scenario, seed, "no-divert")
        local = []
        while not simulation.done:
            simulation.step()
            local.append(simulation.computer.estimate.position)
            if not simulation.done and len(local) in (80, 200):
                covariance = simulation.estimate.covariance
                nees = nees.plus(normalised_squared_error(error_of(simulation), covariance), 9)
        assert simulation.outcome.touchdown is not None, simulation.outcome
        assert np.linalg.norm(error_of(simulation)[3:6]) < 0.1
        assert not simulation.computer.estimate.lost
        assert not {"covariance-inflated", "lost"} & set(events(simulation))
        # The site is corrected by tens of metres; the local frame does not jump. It is tied to the
        # terrain of the first scan, 800 m away: the first star reading, which corrects a tilt of
        # 0.1 deg (1 sigma per axis), moves the lander by a Rayleigh-distributed distance.
        steps = np.linalg.norm(np.diff(np.array(local), axis=0), axis=1)
        moved = 800.0 * np.deg2rad(0.1) * np.sqrt(-2.0 * np.log(CHANCE / count))
        assert steps[1:].max() < 0.1 * 40.0 + moved
        # Later it moves when ranges, and when scans, first meet the small terrain.
        assert (steps[10:] > 0.1 * 40.0).sum() <= 2
    # Two epochs of each flight, of which one is independent.
    low, high = ratio_bounds(count * 9)
    assert low < nees.ratio < high


@pytest.mark.parametrize(
    ("off", "told"), [((0.5, 0.0, 0.0), "beam-excluded"), ((0.5, 0.5, 0.0), "lost")]
)
def test_a_beam_that_lies_alone_is_shut_off_and_two_are_called_lost(scenario, off, told):
    # All beams meet the ground from the start on.
    simulation = Simulation(scenario.changed(terrain={"size_m": 900.0}), 1, "no-divert")
    tampered(simulation, DopplerReading, lambda m: replace(m, speed=m.speed + np.array(off)))
    while simulation.time < 12.0:
        assert not (simulation.computer.estimate.lost and simulation.time < 8.0)
        simulation.step()
    assert {"beam-excluded", "lost"} & set(events(simulation)) == {told}
    assert simulation.computer.estimate.lost == (told == "lost")
    if told == "beam-excluded":
        sigma = np.sqrt(np.diag(simulation.estimate.covariance)[3:6])
        assert (np.abs(error_of(simulation)[3:6]) < 4.0 * sigma).all()
        assert sigma.max() < 0.15


def test_an_altimeter_that_jumps_is_flagged_and_taken_for_terrain(scenario):
    simulation = Simulation(scenario, 2, "no-divert")
    tampered(simulation, AltimeterReading, lambda m: replace(m, range=m.range - 60.0))
    while simulation.time < 20.0:
        simulation.step()
    assert "covariance-inflated" in events(simulation)
    assert np.linalg.norm(error_of(simulation)[3:6]) < 0.3


@pytest.mark.parametrize("value", [np.nan, 1e9, -1e9])
def test_wild_readings_do_no_harm(scenario, value):
    simulation = Simulation(scenario, 3, "no-divert")
    tampered(simulation, AltimeterReading, lambda m: replace(m, range=value), 0.0)
    tampered(
        simulation, DopplerReading, lambda m: replace(m, speed=np.full_like(m.speed, value)), 0.0
    )
    while simulation.time < 5.0:
        simulation.step()
    assert np.isfinite(simulation.computer.navigation.covariance).all()
    assert np.linalg.norm(error_of(simulation)[3:6]) < 3.0


def test_sensors_may_be_called_anything_and_be_there_twice(scenario):
    named = scenario.changed(
        sensors={
            "stars": None, "ground": {"kind": "star-tracker"}, "key": {"kind": "star-tracker"},
            "second": {"kind": "radar-altimeter"}, "third": {"kind": "velocimeter", "beams": 4},
        }
    )  # fmt: skip
    simulation = Simulation(named, 4, "no-divert")
    while simulation.time < 25.0:
        simulation.step()
    watches = simulation.computer.navigation.monitors
    for kind in ("ground attitude", "key attitude", "second range", "third speed of beam 4"):
        assert watches[kind].dof > 15
        assert watches[kind].rejected_count == 0
    assert np.linalg.norm(error_of(simulation)[3:6]) < 0.1


def test_an_accelerometer_that_jumps_is_found_by_its_drift(scenario):
    simulation = Simulation(scenario, 5, "no-divert")
    push = 0.01 * np.array([0.05, 0.0, 0.0])
    tampered(simulation, InertialSamples, lambda m: replace(m, velocity=m.velocity + push), 17.0)
    while simulation.time < 32.0:
        simulation.step()
    # Or by the beam that it errs along the most, which then passes for the liar.
    assert {"drift", "beam-excluded"} & set(events(simulation))
    bias, _ = simulation.computer.navigation.inertial.biases
    assert bias[0] > 3.0 * 0.003, "more than the unit is good for"
    sigma = np.sqrt(np.diag(simulation.estimate.covariance)[3:])
    assert (np.abs(error_of(simulation)[3:]) < 5.0 * sigma).all()


def test_a_computer_takes_nothing_from_before(scenario):
    simulation = Simulation(scenario, 6, "no-divert")
    while simulation.time < 2.0:
        simulation.step()
    computer = simulation.computer
    before = computer.navigation.covariance.copy()
    told = len(computer.telemetry)
    late = (("altimeter", AltimeterReading(1.0, 3.0, 0.1)), ("camera", Late(np.nan)),
            ("camera", Late(9.0)))  # fmt: skip
    computer.update(Measurements(computer.time, late))
    assert [name for _, name, _ in computer.telemetry[told:]] == ["out-of-order"] * 3
    assert np.array_equal(computer.navigation.covariance, before)
    with pytest.raises(InputError, match="time"):
        computer.update(Measurements(computer.time - 0.1))


class Late:
    """A picture or scan of which only its time counts."""

    def __init__(self, time: float) -> None:
        self.time = time


@pytest.mark.statistical
@sample_sizes(2, 4)
def test_the_unscented_filter_has_the_stated_error(scenario, count):
    plain = scenario.changed(
        navigation={"kind": "ukf"}, sensors={"flash": None}, tasking={"flash": None}
    )
    nees, mass = Consistency(), []
    for seed in range(count):
        simulation = Simulation(plain, seed, "no-divert")
        navigation, epochs = simulation.computer.navigation, 0
        while not simulation.done:
            simulation.step()
            epochs += 1
            if not simulation.done and epochs in (80, 200, 300):
                covariance = simulation.estimate.covariance
                nees = nees.plus(normalised_squared_error(error_of(simulation), covariance), 9)
                mass.append(navigation.mass[0] - simulation.state.mass)
        assert simulation.outcome.touchdown is not None, simulation.outcome
        # What beams are off by over a flight it has no states for.
        assert np.linalg.norm(error_of(simulation)[3:6]) < 0.4
        assert not simulation.computer.estimate.lost
        assert not {"covariance-inflated", "lost"} & set(events(simulation))
    # Modest: what lasts and is taken for noise is made larger. Never sure of too much.
    assert 0.4 < nees.ratio < ratio_bounds(count * 9)[1]
    assert np.abs(mass).max() < 1.0


def test_scans_speeds_and_ranges_report_neither_place_nor_yaw(scenario):
    """Without stars and map: a hundred scans and clones, and no certainty that cannot be had."""
    blind = scenario.changed(
        sensors={"stars": None}, tasking={"flash": {"kind": "periodic", "rate_hz": 5.0}},
        initial_uncertainty={"position_m": 10.0, "velocity_m_s": 0.3, "attitude_deg": 0.1},
    )  # fmt: skip
    simulation = Simulation(blind, 2, "no-divert")
    navigation = simulation.computer.navigation
    start = np.linalg.norm(navigation.inertial.velocity[:2])
    # All that is known of yaw: how it was told, and the way that the start's velocity points.
    told = np.deg2rad(0.1)
    yaw = 1.0 / np.hypot(1.0 / told, start / 0.3)
    assert yaw > 0.98 * told
    while simulation.time < 25.0:
        simulation.step()
        p = navigation.frame.covariance_in_site()
        up = quat_to_matrix(navigation.inertial.attitude)[2]
        assert np.sqrt(np.diag(p)[:2]).min() > 0.9999 * 10.0
        assert np.sqrt(up @ p[6:9, 6:9] @ up) > 0.998 * yaw
    assert np.sqrt(p[2, 2]) < 0.9 * 10.0, "height is told"
    assert np.sqrt(np.diag(p)[3:6]).max() < 0.1, "speed is told"


def test_it_navigates_over_a_round_moon(scenario):
    """The error over a sphere is that over a plane: 20 km away, the sphere is 115 m lower."""
    start = {"position_m": [-20_000.0, 0.0, 6_000.0], "velocity_m_s": [150.0, 0.0, -30.0]}
    around = {"sizes_m": [80_000.0], "postings_m": [200.0], "rms_slopes_deg": [0.0]}
    errors = []
    for moon in ({}, {"moon": {}}):
        flown = scenario.changed(start=start, far_terrain=around, **moon)
        simulation = Simulation(flown, 3, "no-divert")
        for _ in range(400):
            simulation.step()
        errors.append(simulation.site_error)
        assert "covariance-inflated" not in events(simulation)
    # Both flights have the same random draws.
    assert errors[1] == pytest.approx(errors[0], abs=3.0)
    assert abs(errors[1][2]) < 10.0


def test_inertial_navigation_follows_an_orbit_over_a_round_moon():
    from lunarsim.models.gravity import RoundMoon
    from lunarsim.onboard.navigation.inertial import StrapdownState

    moon = RoundMoon(spin=2e-5, latitude=0.5).gravity(1.622)
    place, speed = np.array([0.0, 0.0, 15_000.0]), np.array([1_600.0, 50.0, 0.0])
    level = np.array([0.0, 0.0, 0.0, 1.0])
    nav = StrapdownState(place, speed, level, 1.622, gravity_model=moon)
    x = np.concatenate((place, speed))

    def slope(y):
        r = y[:3] + [0.0, 0.0, moon.radius]
        pull = -1.622 * moon.radius**2 * r / np.linalg.norm(r) ** 3
        w = moon.spin
        return np.concatenate(
            (y[3:], pull - 2.0 * np.cross(w, y[3:]) - np.cross(w, np.cross(w, r)))
        )

    for _ in range(1_500):  # Runge-Kutta, 0.1 s
        nav.propagate(np.zeros((10, 3)), np.zeros((10, 3)))
        a = slope(x)
        b = slope(x + 0.05 * a)
        c = slope(x + 0.05 * b)
        d = slope(x + 0.1 * c)
        x = x + 0.1 / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    assert nav.position == pytest.approx(x[:3], abs=0.1)
    assert nav.velocity == pytest.approx(x[3:], abs=1e-3)
    assert abs(x[2] - place[2]) > 1_000.0


def test_a_flight_reports_beams_that_miss_the_map(scenario):
    """Without far terrain, events and the summary name the sensors; with it, there are none."""
    start = {"position_m": [-300.0, 0.0, 200.0], "velocity_m_s": [20.0, 0.0, -8.0]}
    near = {"sizes_m": [8_000.0], "postings_m": [40.0], "rms_slopes_deg": [0.0]}
    flights = [
        Simulation(scenario.changed(start=start, **more), 1, "no-divert").run()
        for more in ({}, {"far_terrain": near})
    ]
    edge = [(e["time"], e["name"]) for e in flights[0].events if e.get("sensor") == "altimeter"]
    assert edge[0] == (0.0, "beams-off-map")
    assert edge[1][1] == "beams-on-map"
    flown = flights[0].trajectory
    x = np.interp(edge[1][0], flown["time"], flown["position_x"])
    assert -200.0 < x < -40.0  # the map ends at -120 m; the lander is tilted
    assert f"altimeter {edge[1][0]:.1f} s" in str(flights[0])
    assert "add [far_terrain]" in str(flights[0])
    assert not [e for e in flights[1].events if e["name"].startswith("beams-o")]
    assert "far_terrain" not in str(flights[1])
