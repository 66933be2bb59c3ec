"""What another eye leaves of rocks that no sample has met."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.errors import InputError
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.safety.undetected_rock_ratio import UndetectedRockRatio
from tests.map_evidence import SIDE, evidence, rocky
from tests.reference import fusion as plain

DIAMETERS = np.array([0.5, 0.7, 1.0])
ratios = st.lists(st.floats(0.05, 6.0), min_size=3, max_size=3)


def thinning(ratio=(0.1, 0.1, 0.1), shape=(SIDE, SIDE)) -> UndetectedRockRatio:
    whole = np.empty((3, *shape), np.float32)
    whole[:] = np.reshape(np.asarray(ratio, np.float32), (3, 1, 1))
    return UndetectedRockRatio(DIAMETERS, whole, 0.05, 0.5)


@given(ratios, st.floats(0.0, 0.8))
def test_what_is_left_equals_a_plain_sum_over_sizes(ratio, height):
    """To 2e-4: both add up the same law, whose table has an error of 1e-6 a diameter."""
    found = thinning(ratio, (1, 1)).at(height)[0, 0]
    told = [float(np.float32(r)) for r in ratio]
    assert found == pytest.approx(
        plain.remaining_ratio(height, list(DIAMETERS), told, 0.05, 0.5), rel=2e-4
    )


@given(ratios, st.floats(0.0, 0.8), st.floats(0.0, 0.5), st.integers(0, 2), st.floats(0.0, 2.0))
def test_it_never_rises_with_the_height_nor_falls_with_a_ratio(ratio, height, more, which, worse):
    here = thinning(ratio, (1, 1))
    assert here.at(height + more)[0, 0] <= here.at(height)[0, 0] + 1e-12
    bad = list(ratio)
    bad[which] += worse
    assert thinning(bad, (1, 1)).at(height)[0, 0] >= here.at(height)[0, 0] - 1e-12


def test_each_site_has_its_own_height_and_none_without_one():
    rng = np.random.default_rng(5)
    told = rng.uniform(0.1, 3.0, (3, 4, 5)).astype(np.float32)
    heights = rng.uniform(0.0, 3.0, (4, 5))
    heights[1, 2] = np.nan
    found = UndetectedRockRatio(DIAMETERS, told, 0.05, 0.5).at(heights)
    for at in np.ndindex(heights.shape):
        ratio = [float(r) for r in told[:, *at]]
        if np.isnan(heights[at]):
            assert np.isnan(found[at])
        else:
            expected = plain.remaining_ratio(heights[at], list(DIAMETERS), ratio, 0.05, 0.5)
            assert found[at] == pytest.approx(expected, rel=2e-4)


def unseen(height, where=None, *, number=2.0, density=10.0):
    """Return rocks above heights that samples have missed."""
    h = np.asarray(height, np.float64)
    each = number * np.exp(-4.0 * h - density * h * h)
    if where is not None:
        return np.broadcast_to(each, (int(where.sum()),)) if not h.ndim else each
    return np.broadcast_to(each, (1, 1)).copy()


@given(ratios, st.floats(0.0, 0.8), st.booleans())
def test_what_is_left_of_each_size_equals_a_plain_sum(ratio, height, raster):
    h = np.full((1, 1), height) if raster else np.array(height)
    found = thinning(ratio, (1, 1)).remaining_rocks(unseen, h)[0, 0]
    told = [float(np.float32(r)) for r in ratio]
    expected = plain.remaining_rocks(
        height, list(DIAMETERS), told, 0.05, 0.5, lambda x: float(unseen(x)[0, 0])
    )
    assert found == pytest.approx(expected, rel=2e-4)


@given(
    ratios, st.floats(0.0, 0.8), st.floats(0.0, 0.5), st.integers(0, 2), st.floats(0.0, 2.0),
    st.floats(0.0, 1.0),
)  # fmt: skip
def test_none_of_a_size_are_left_for_better_evidence_than_for_worse(
    ratio, height, more, which, worse, share
):
    def left(of=ratio, above=height, **changes):
        def before(x, where=None):
            return unseen(x, where, **changes)

        return thinning(of, (1, 1)).remaining_rocks(before, np.array(above))[0, 0]

    here, bad = left(), list(ratio)
    bad[which] += worse
    assert left(above=height + more) <= here + 1e-12
    assert left(bad) >= here - 1e-12
    assert left(number=2.0 * (1.0 + worse)) >= here - 1e-12
    # Fewer samples have missed more of them, of large ones most.
    assert left(density=10.0 * share) >= here - 1e-12


def test_where_only_a_large_rock_may_be_there_are_no_more_small_ones():
    dark = thinning((1.0, 1.0, 200.0))

    def missed(x, where=None):
        return unseen(x, where, density=40.0)

    here = thinning((1.0, 1.0, 200.0), (1, 1))
    assert here.remaining_rocks(missed, np.array(0.25))[0, 0] < 1.1 * missed(0.25)[0, 0]
    # By the law's own sizes it would be 200 times as many.
    assert dark.at(0.25)[0, 0] > 150.0


def test_where_nothing_was_seen_all_are_left():
    here = thinning((1.0, 1.0, 1.0))
    assert not here.is_changed.any()
    assert (here.at(0.3) == 1.0).all()
    assert (here.at(np.full((SIDE, SIDE), 0.1)) == 1.0).all()
    # Pebbles that no look can tell of are left whole, large rocks as they are missed.
    seen = thinning()
    assert seen.at(0.02)[0, 0] > 0.9
    assert seen.at(0.25)[0, 0] == pytest.approx(0.1)


def test_heights_beyond_the_law_have_the_last_ratio():
    assert thinning((0.4, 0.3, 0.2)).at(1e4)[0, 0] == pytest.approx(0.2)


@pytest.mark.parametrize("slope", [0.0, 0.6])
def test_fewer_unseen_rocks_make_sites_safer_and_more_less_safe(slope):
    plainly = evidence(slope=slope, rough=0.1, density=5.0, curve=rocky(16.0))
    p = [
        calibrated_safety(replace(plainly, undetected_rock_ratio=t))[0].mean()
        for t in (thinning((4.0, 4.0, 4.0)), None, thinning())
    ]
    assert p[0] < p[1] < p[2]
    for name in ("expected_hazards", "expected_roughness_violations", "expected_tilt_violations"):
        fewer = getattr(replace(plainly, undetected_rock_ratio=thinning()), name)
        assert (fewer < getattr(plainly, name)).all(), name
    # Holes are no rocks.
    fewer = replace(plainly, undetected_rock_ratio=thinning())
    assert np.array_equal(fewer.expected_hole_violations, plainly.expected_hole_violations)


def test_bad_figures_are_refused():
    good = thinning()
    for field, changes in {
        "diameter": {"diameter": DIAMETERS[::-1]},
        "ratio": {"ratio": -good.ratio},
        "height_ratio": {"height_ratio": 0.0},
    }.items():
        with pytest.raises(InputError, match=rf"undetected_rock_ratio\.{field}"):
            replace(good, **changes)
    with pytest.raises(InputError, match=r"undetected_rock_ratio\.ratio"):
        replace(good, ratio=good.ratio[:2])
    with pytest.raises(InputError, match=r"calibration\.undetected_rock_ratio"):
        replace(evidence(), undetected_rock_ratio=thinning(shape=(2, 2)))
