"""Published landings of least propellant, and what has to hold for any of them."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.optimal.errors import InfeasibleError
from lunarsim.optimal.final_time import minimize_landing_error, minimize_propellant
from lunarsim.optimal.planner import Planner
from tests.optimal.cases import east_north_up, mars, published

SLOPE = np.deg2rad(4.0)


@pytest.fixture(scope="module")
def table():
    return published()


@pytest.mark.parametrize(
    ("case", "glideslope"),
    [("AP2007_no_glideslope", None), ("AP2007_glideslope_4deg", SLOPE), ("BAS2010_case1", SLOPE)],
)
def test_published_propellant_at_published_times(table, case, glideslope):
    r, v = (east_north_up(table[case, name]) for name in ("r0", "v0"))
    path = Planner(60).at_time(mars(r, v, glideslope=glideslope), float(table[case, "tf"]))
    wanted = float(table[case, "fuel_published"].split()[0])
    assert path.propellant == pytest.approx(wanted, rel=5e-3)
    assert path.propellant == pytest.approx(path.mass[0] - path.mass[-1], rel=1e-9)


def test_the_mars_case_with_a_free_final_time():
    """Above its end all the way: 390.4 kg in 74.4 s; 353.3 kg without the cosine of the cant."""
    path = minimize_propellant(Planner(60), mars(glideslope=0.0))
    assert path.propellant == pytest.approx(390.4, rel=5e-4)
    assert path.duration == pytest.approx(74.4, rel=5e-3)
    assert path.position[:, 2].min() > -1e-3
    straight = 225.0 * 9.80665
    plain = minimize_propellant(Planner(60), mars(glideslope=0.0, exhaust_velocity=straight))
    assert plain.propellant == pytest.approx(353.3, rel=5e-3)


def test_what_cannot_be_reached_with_the_tanks_is_reported_with_what_can(table):
    """The second case of Blackmore: 400 kg do not do; the nearest end can be reached, no nearer."""
    start = {"position": (2000.0, 500.0, 1500.0), "velocity": (100.0, 40.0, -75.0)}
    planner = Planner(40)
    duration = float(table["BAS2010_case2", "tf"])
    full = planner.at_time(mars(**start, dry_mass=1300.0, glideslope=SLOPE), duration)
    assert full.propellant >= 410.0
    with pytest.raises(InfeasibleError, match="m away") as found:
        minimize_propellant(planner, mars(**start, glideslope=SLOPE))
    nearest, miss = found.value.nearest, found.value.miss
    assert found.value.field == "optimal.end_position"
    path = minimize_landing_error(planner, mars(**start, glideslope=SLOPE))
    assert path.miss == pytest.approx(miss, rel=2e-3)
    assert path.loss < 1e-4
    assert path.mass[-1] == pytest.approx(1505.0, abs=0.1)
    there = minimize_propellant(planner, mars(**start, glideslope=SLOPE, end_position=nearest))
    assert there.propellant == pytest.approx(400.0, abs=0.1)
    nearer = 0.99 * nearest
    with pytest.raises(InfeasibleError):
        minimize_propellant(planner, mars(**start, glideslope=SLOPE, end_position=nearer))


def test_a_region_costs_no_more_than_a_place_and_is_ended_at_its_edge():
    planner = Planner(40)
    place = planner.at_time(mars(glideslope=SLOPE), 81.0)
    disc = planner.at_time(mars(glideslope=SLOPE, region=50.0), 81.0)
    assert disc.propellant < place.propellant - 1.0
    assert disc.miss == pytest.approx(50.0, abs=0.01)
    assert disc.position[-1, 2] == pytest.approx(0.0, abs=1e-6)
    assert np.allclose(disc.velocity[-1], 0.0, atol=1e-6)
