"""Test the registration of tracked rocks to elevations of another sensor."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.fusion.elevation_samples import ElevationSamples
from lunarsim.onboard.hazards.fusion.registration import estimate_shift, register_tracks
from lunarsim.onboard.hazards.map_evidence import RockTracks
from tests.camera_and_lidar import bumps
from tests.reference import fusion as plain

SMALL = Grid(1.0, -2.0, 0.25, 16, 15)
WIDE = Grid.centred((0.0, 0.0), 30.0, 0.25)


def tracks(xy, radius, sigma) -> RockTracks:
    n = len(xy)
    return RockTracks(
        np.asarray(xy, float), np.full(n, sigma), np.full(n, radius), np.full(n, 0.01),
        np.full(n, 0.99),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_the_shift_equals_the_posterior_by_enumeration(seed):
    """To 1e-6: the same sum of a few hundred shifts, in other units."""
    rng = np.random.default_rng(seed)
    west, east, south, north = SMALL.extent
    xy = rng.uniform((west, south), (east, north), (4, 2))
    residual_heights = bumps(xy + [0.5, -0.25], SMALL, 0.4, 6.0, rng)
    rocks = tracks(xy, 0.4, 0.3)
    found = estimate_shift(
        rocks, ElevationSamples(residual_heights, np.full(SMALL.shape, 6.0), SMALL, 0.5), 1.0
    )
    expected = plain.common_shift(
        [(x, y, 0.4, 0.3) for x, y in xy], residual_heights, SMALL.x0, SMALL.y0, SMALL.posting, 6.0,
        0.5,
    )  # fmt: skip
    assert (*found.correction, found.sigma) == pytest.approx(expected, abs=1e-6)
    assert found.prior_sigma == pytest.approx(0.3)


def test_rocks_are_moved_to_where_the_elevations_show_them():
    rng = np.random.default_rng(3)
    true = rng.uniform(-12.0, 12.0, (30, 2))
    off = np.array([-1.75, 0.5])
    residual_heights = bumps(true, WIDE, 0.4, 3.0, rng)
    before = tracks(true - off, 0.4, 1.5)
    after = register_tracks(
        before, ElevationSamples(residual_heights, np.full(WIDE.shape, 3.0), WIDE, 0.5), 1.0
    )
    assert after.xy - before.xy == pytest.approx(np.broadcast_to(off, (30, 2)), abs=0.2)
    assert (after.sigma < 0.3).all()
    # The result is as certain as the shift, plus the relative position error of each rock.
    shift = estimate_shift(
        before, ElevationSamples(residual_heights, np.full(WIDE.shape, 3.0), WIDE, 0.5), 1.0
    )
    assert after.sigma == pytest.approx(np.hypot(shift.sigma, 0.15))
    assert np.array_equal(after.radius, before.radius)


def test_without_informative_elevations_places_do_not_change():
    rng = np.random.default_rng(4)
    before = tracks(rng.uniform(-12.0, 12.0, (30, 2)), 0.4, 1.0)
    residual_heights = np.full(WIDE.shape, np.nan, np.float32)
    after = register_tracks(
        before, ElevationSamples(residual_heights, np.zeros(WIDE.shape), WIDE, 0.5), 1.0
    )
    assert after.xy == pytest.approx(before.xy, abs=1e-9)
    assert after.sigma == pytest.approx(before.sigma, rel=0.05)


def test_few_rocks_give_no_shift():
    few = tracks([[0.0, 0.0], [1.0, 1.0], [90.0, 0.0]], 0.4, 1.0)
    residual_heights = np.zeros(WIDE.shape, np.float32)
    assert (
        register_tracks(
            few, ElevationSamples(residual_heights, np.ones(WIDE.shape), WIDE, 0.5), 1.0
        )
        is few
    )
    assert (
        estimate_shift(few, ElevationSamples(residual_heights, np.ones(WIDE.shape), WIDE, 0.5), 1.0)
        is None
    )


def test_no_place_becomes_less_well_known():
    rng = np.random.default_rng(5)
    true = rng.uniform(-12.0, 12.0, (12, 2))
    residual_heights = bumps(true, WIDE, 0.4, 3.0, rng)
    for sigma in (0.05, 0.3, 2.0):
        after = register_tracks(
            tracks(true, 0.4, sigma),
            ElevationSamples(residual_heights, np.full(WIDE.shape, 3.0), WIDE, 0.5),
            1.0,
        )
        assert (after.sigma <= max(sigma, 0.15) + 1e-12).all()
