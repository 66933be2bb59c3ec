"""How well places are known by the rocks about them."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.hazards.shadows.terrain_errors import position_sigma
from tests.shadow_scene import tracker_at


@pytest.fixture
def rocks():
    """Return a filter with 25 rocks whose errors go together at random."""
    rocks = tracker_at((0.0, 0.0, 60.0)).filter
    rng = np.random.default_rng(3)
    rocks.add_known(
        rng.uniform(-30.0, 30.0, (25, 2)), np.full(25, 0.3), np.full(25, 0.5), np.full(25, 0.1)
    )
    size = rocks.state.size
    factor = rng.normal(0.0, 0.1, (size, size + 5)) * rng.uniform(0.2, 4.0, (size, 1))
    rocks.state.p[:size, :size] = factor @ factor.T
    return rocks


def weights(rocks, chosen, axis):
    """Return what takes the mean place of rocks off the lander from the error state."""
    out = np.zeros(rocks.state.size)
    out[axis] -= 1.0
    for rock in chosen:
        out[rocks.first + 3 * rock + axis] += 1.0 / len(chosen)
    return out


def test_places_are_known_as_the_mean_of_the_rocks_about_is_or_their_median(rocks):
    where = np.random.default_rng(4).uniform(-40.0, 40.0, (60, 2))
    p = rocks.state.p[: rocks.state.size, : rocks.state.size]
    by_mean = 0
    for xy, found in zip(where, position_sigma(rocks, where), strict=True):
        near = sorted(range(25), key=lambda k: np.hypot(*(rocks.xy[k] - xy)))[:8]

        def sigma(chosen):
            both = [w @ p @ w for w in (weights(rocks, chosen, axis) for axis in (0, 1))]
            return np.sqrt(0.5 * sum(both))

        mean, median = sigma(near), np.median([sigma([k]) for k in near])
        by_mean += mean < median
        assert found == pytest.approx(min(mean, median), rel=1e-9)
    assert by_mean > 0
    # Where the median is good enough it is given.
    medians = position_sigma(rocks, where, sufficient_sigma=1e3)
    assert (medians >= position_sigma(rocks, where)).all()
    assert (medians > position_sigma(rocks, where)).sum() == by_mean


def test_rocks_with_independent_errors_give_places_together():
    tracker = tracker_at((0.0, 0.0, 60.0))
    where = np.array([[-20.0, 0.0], [20.0, 0.0], [0.0, 200.0]])
    # Nothing holds the lander to the ground.
    assert np.isposinf(position_sigma(tracker.filter, where)).all()
    west = np.column_stack((np.linspace(-24.0, -17.0, 8), np.zeros(8)))
    tracker.filter.add_known(west, np.full(8, 0.4), np.full(8, 0.5), np.full(8, 0.1))
    tracker.filter.add_known(
        -west, np.append(np.full(7, 0.1), 9.0), np.full(8, 0.5), np.full(8, 0.1)
    )
    # What lander and rocks share does not count: here they share nothing.
    shared = np.sqrt(0.5 * np.trace(tracker.filter.state.p[:2, :2]))
    found = position_sigma(tracker.filter, where)
    assert found[0] == pytest.approx(np.hypot(0.4 / np.sqrt(8.0), shared), rel=0.02)
    # One rock of eight that is not known spoils the mean, but not the median.
    assert found[1] == pytest.approx(np.hypot(0.1, shared), rel=0.02)
