"""Ground that is proven to be out of reach, for landers, cones and boxes of all kinds."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.core.path_cost import GLIDE, TAN_TILT
from lunarsim.scenario import Scenario
from lunarsim_envs.descent.batch import VehicleParams
from lunarsim_envs.sites import _beyond_kernels as b
from lunarsim_envs.sites import _flight_kernels as f
from lunarsim_envs.sites import reachable_candidates as stead
from lunarsim_envs.sites.batch import kernel_guidance
from tests.chance import sample_sizes


@pytest.fixture(scope="module")
def law():
    scenario = Scenario.from_dict({})
    return kernel_guidance(scenario, VehicleParams.of(scenario))


def proven(law, glide, tilt, state, mass, low, high):
    """Return whether a box is proven to be out of reach, and the law with these limits."""
    figures = law.paths.params.copy()
    figures[GLIDE], figures[TAN_TILT] = np.tan(np.deg2rad([glide, tilt]))
    own = law._replace(paths=law.paths._replace(params=figures))
    how = stead.reach_lander(state, mass, own)
    return b.is_unreachable(
        how.paths, state, low, high, how.speed, how.max_acceleration, own, how.params
    ), own


def reached(own, state, mass, targets):
    """Return which targets can be reached, tried one by one."""
    out = np.empty((len(targets), 4))
    f.compute_divert_costs(state, mass, targets - own.end_offset, own, out)
    return np.isfinite(out[:, 0])


def inside(low, high, rng, count=24):
    """Return corners, middle and random points of a box."""
    ends = np.array([low, high])
    corners = [[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    return np.vstack((corners, 0.5 * (low + high), rng.uniform(low, high, (count, 3))))


@sample_sizes(3_000, 12_000)
def test_what_is_proven_is_so_and_most_is_proven(law, count):
    """Far and near, flat and tall boxes; steep and shallow cones; rising and falling landers."""
    rng, lost, claimed = np.random.default_rng(0), 0, 0
    for _ in range(count):
        glide, tilt = rng.choice([3.0, 8.0, 20.0, 45.0]), rng.choice([10.0, 20.0, 40.0, 60.0])
        place = np.append(rng.uniform(-300.0, 300.0, 2), rng.uniform(10.0, 400.0))
        velocity = np.append(rng.normal(0.0, 15.0, 2), rng.uniform(-40.0, 15.0))
        state, mass = np.array([place, velocity]), float(rng.uniform(1100.0, 1500.0))
        middle = np.append(rng.uniform(-300.0, 300.0, 2), rng.uniform(-30.0, 30.0))
        half = rng.random(3) * [*[rng.choice([1.0, 10.0, 50.0])] * 2, rng.choice([0.1, 5.0, 40.0])]
        low, high = middle - half, middle + half
        yes, own = proven(law, glide, tilt, state, mass, low, high)
        there = reached(own, state, mass, inside(low, high, rng)).any()
        assert not (yes and there)
        lost, claimed = lost + (not there), claimed + yes
    # A proof that gives up more often is of less use: this is what it had when it was written.
    assert claimed / lost > 0.69


# Corners that can only just be reached, of boxes next to which all is out of reach: what has them
# proven lost is cone and lean, deg, place, velocity, mass, middle and half sides, the corner.
NARROW = [
    (45, 40, (-100.866, 161.252, 373.983), (11.415, -1.683, -37.197), 1163.14,
     (83.121, 270.48, 9.375), (0.18, 0.47, 0.08), (82.941, 270.011, 9.295)),
    (45, 60, (46.205, 105.092, 387.222), (3.057, -2.262, -34.116), 1409.2,
     (212.501, -49.398, -24.336), (9.554, 6.634, 2.407), (202.947, -42.764, -26.743)),
    (45, 40, (-227.973, 234.284, 387.434), (6.03, -11.919, -34.853), 1454.09,
     (-118.906, -74.176, -25.822), (0.282, 0.257, 4.294), (-119.188, -73.919, -30.117)),
    (3, 20, (-64.866, -55.429, 146.838), (-9.839, -15.04, -16.403), 1339.24,
     (-184.762, -183.224, 7.94), (0.836, 0.12, 29.754), (-185.599, -183.345, 37.694)),
    (20, 40, (-101.796, 111.803, 228.596), (2.194, -6.944, -27.876), 1157.45,
     (-84.853, -218.778, 5.391), (0.051, 0.758, 30.891), (-84.904, -219.536, -25.5)),
    (3, 60, (-29.89, 259.749, 289.274), (29.239, 8.276, -35.432), 1202.55,
     (248.745, 241.693, -14.111), (0.739, 0.321, 14.428), (248.006, 241.372, -28.539)),
]  # fmt: skip


@pytest.mark.parametrize("case", NARROW, ids=lambda case: f"{case[0]}-{case[1]}-{case[4]:.0f}")
def test_a_corner_in_reach_keeps_its_box(law, case):
    glide, tilt, place, velocity, mass, middle, half, corner = case
    state = np.array([place, velocity])
    low, high = np.array(middle) - half, np.array(middle) + half
    yes, own = proven(law, glide, tilt, state, mass, low, high)
    assert not yes
    assert reached(own, state, mass, np.array([corner])).all()
