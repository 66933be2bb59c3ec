"""The compiled survey of times-to-go against paths sampled one by one."""

import numba
import numpy as np
import pytest

from lunarsim.core import divert as kernels
from tests.reference import divert as plain

POWERS = [(1.0, 2.0), (0.0, 1.0), (0.5, 1.3), (1.0, 4.0)]


def table_of(powers, samples):
    left = np.linspace(1.0, 0.0, samples + 1)
    return np.stack((left, left ** powers[0], left ** powers[1]), axis=1)


@pytest.mark.parametrize("powers", POWERS)
@pytest.mark.parametrize(
    ("least", "most", "tan_tilt", "glide", "tan_end"),
    [
        (0.0, 1e9, 1e9, -1e9, 1e9),  # nothing limits
        (2300.0, 5000.0, 1e9, -1e9, 1e9),
        (0.0, 1e9, 0.4, -1e9, 0.4),
        (0.0, 1e9, 1e9, 0.6, 1e9),
        (0.0, 1e9, 1e9, -1e9, 0.2),
        (1500.0, 5500.0, 0.7, 0.3, 0.5),
    ],
)
def test_what_a_path_takes(powers, least, most, tan_tilt, glide, tan_end):
    rng = np.random.default_rng(5)
    count, samples = 30, 12
    r, v = np.array([-200.0, 40.0, 260.0]), np.array([14.0, -3.0, -12.0])
    targets = np.column_stack((rng.uniform(-80.0, 80.0, (count, 2)), rng.normal(0.0, 5.0, count)))
    v_f, a_f = np.array([0.3, -0.2, -2.0]), np.array([0.1, 0.05, 0.2])
    times = rng.uniform(15.0, 60.0, (9, count))
    times[3, 4] = np.nan
    figures = (samples, 1.62, 1480.0, 3050.0, least, most, tan_tilt, glide, tan_end)
    table = table_of(powers, samples)
    given = np.array([1.62, 1480.0, 3050.0, least, most, tan_tilt, glide, tan_end])
    state, asked = np.array([r, v]), np.array([v_f, a_f])
    reached = 0
    for row in times:
        out = np.empty((count, 4))
        kernels.search_sites(
            state, targets, asked, row, row, 1, table, table, np.array(powers), given, out
        )
        wanted = np.array([
            plain.best(r, v, target, v_f, a_f, [time], *figures, powers)
            for target, time in zip(targets, row, strict=True)
        ])  # fmt: skip
        assert out == pytest.approx(wanted, rel=1e-9, nan_ok=True)
        # And the same where there is nothing to search.
        one = np.empty((count, 4))
        kernels.evaluate_given_times(
            state, targets, asked, row, table, np.array(powers), given, one
        )
        assert one == pytest.approx(wanted, rel=1e-9, nan_ok=True)
        reached += np.isfinite(wanted[:, 0]).sum()
    assert reached >= 1


def test_a_path_that_burns_much_of_the_mass():
    """So poor an engine that a step takes more than a fiftieth of the mass."""
    powers, samples, exhaust = (1.0, 2.0), 12, 120.0
    r, v = np.array([-200.0, 40.0, 260.0]), np.array([14.0, -3.0, -12.0])
    target, v_f, a_f = np.zeros((1, 3)), np.array([0.0, 0.0, -2.0]), np.zeros(3)
    table, time, out = table_of(powers, samples), np.array([30.0]), np.empty((1, 4))
    given = np.array([1.62, 1480.0, exhaust, 0.0, 1e9, 1e9, -1e9, 1e9])
    kernels.search_sites(
        np.array([r, v]), target, np.array([v_f, a_f]), time, time, 1, table, table,
        np.array(powers), given, out,
    )  # fmt: skip
    figures = (samples, 1.62, 1480.0, exhaust, 0.0, 1e9, 1e9, -1e9, 1e9)
    wanted = plain.best(r, v, target[0], v_f, a_f, [30.0], *figures, powers)
    assert out[0] == pytest.approx(wanted, rel=1e-9)
    with_much = plain.best(r, v, target[0], v_f, a_f, [30.0], samples, 1.62, 1480.0, 1e9,
                           *figures[4:], powers)  # fmt: skip
    assert wanted[2] < 0.95 * with_much[2]


def test_search_ends_at_the_edge_of_what_is_admissible():
    """Longer is cheaper here until the path sinks below the glideslope; nothing better is near."""
    powers, samples = (1.0, 2.0), 24
    r, v = np.array([-200.0, 40.0, 260.0]), np.array([14.0, -3.0, -12.0])
    target, v_f, a_f = np.zeros((1, 3)), np.array([0.0, 0.0, -2.0]), np.zeros(3)
    table = table_of(powers, samples)
    given = np.array([1.62, 1480.0, 3050.0, 1500.0, 5500.0, 0.7, 0.2, 0.7])
    figures = (samples, 1.62, 1480.0, 3050.0, 1500.0, 5500.0, 0.7, 0.2, 0.7)
    out = np.empty((1, 4))
    kernels.search_sites(
        np.array([r, v]), target, np.array([v_f, a_f]), np.array([5.0]), np.array([200.0]), 14,
        table_of(powers, 8), table, np.array(powers), given, out,
    )  # fmt: skip
    fine = plain.best(r, v, target[0], v_f, a_f, np.geomspace(5.0, 200.0, 4000), *figures, powers)
    assert out[0, 0] == pytest.approx(fine[0], rel=5e-3)
    assert out[0, 0] >= fine[0] * (1.0 - 1e-9)


@pytest.mark.parametrize("glide", [0.25, 0.0, -1e9])
def test_a_site_is_evaluated_alike_whoever_stands_beside_it(glide):
    powers, samples = (1.0, 2.0), 24
    rng = np.random.default_rng(11)
    state = np.array([[-150.0, 40.0, 260.0], [14.0, -3.0, -12.0]])
    asked = np.array([[0.0, 0.0, -2.0], np.zeros(3)])
    targets = np.column_stack((rng.uniform(-400.0, 400.0, (50, 2)), rng.normal(0.0, 5.0, 50)))
    first, last = rng.uniform(4.0, 12.0, 50), rng.uniform(40.0, 200.0, 50)
    first[7], last[9], last[11] = np.nan, 2.0, np.inf
    given = np.array([1.62, 1480.0, 3050.0, 1500.0, 5500.0, 0.7, glide, 0.6])
    tables = table_of(powers, 8), table_of(powers, samples), np.array(powers)

    def surveyed(k):
        out = np.empty((len(k), 4))
        kernels.search_sites(state, targets[k], asked, first[k], last[k], 14, *tables, given, out)
        return out

    every = surveyed(np.arange(50))
    assert 0.1 < np.isfinite(every[:, 0]).mean() < 0.95
    assert not np.isfinite(every[[7, 9, 11], 0]).any()
    alone = np.vstack([surveyed(np.array([n])) for n in range(50)])
    assert np.array_equal(alone, every, equal_nan=True)
    turned = rng.permutation(50)[:17]
    assert np.array_equal(surveyed(turned), every[turned], equal_nan=True)
    # What is written is the path's, to the last bit but a few, at the time that is written.
    figures = (samples, 1.62, 1480.0, 3050.0, 1500.0, 5500.0, 0.7, glide, 0.6)
    for n in np.flatnonzero(np.isfinite(every[:, 0])):
        told = plain.best(*state, targets[n], *asked, [every[n, 1]], *figures, powers)
        assert every[n] == pytest.approx(told, rel=1e-9)


@numba.njit
def lanes_of(w, state, asked, table, powers, figures):
    kernels.evaluate_lanes(w, state, asked, table, powers, figures)


@pytest.mark.parametrize("glide", [0.25, 0.0, -0.3, -1e9])
def test_sixteen_side_by_side_cost_what_each_costs_alone(glide):
    """Increments to single precision, and the same ones out of limits."""
    powers, samples = (0.5, 1.3), 8
    rng = np.random.default_rng(9)
    r, v = np.array([-150.0, 40.0, 160.0]), np.array([10.0, -3.0, -9.0])
    v_f, a_f = np.array([0.2, -0.1, -2.0]), np.array([0.05, 0.1, 0.2])
    figures = (1.62, 1480.0, 900.0, 1500.0, 4600.0, 0.7, glide, 0.5)
    w, good = np.zeros(80, np.float32), 0
    for _ in range(60):
        high = rng.normal(0.0, 9.0 if glide > 0.0 else 90.0, 16)
        targets = np.column_stack((rng.uniform(-90.0, 90.0, (16, 2)), high))
        times = rng.uniform(14.0, 45.0, 16)
        w[:48], w[48:64] = targets.T.ravel(), times
        lanes_of(
            w, np.array([r, v]), np.array([v_f, a_f]), table_of(powers, samples),
            np.array(powers), np.array(figures),
        )  # fmt: skip
        for k in range(16):
            told = plain.best(r, v, targets[k], v_f, a_f, [times[k]], samples, *figures, powers)
            assert (w[64 + k] < 1e29) == np.isfinite(told[0])
            if np.isfinite(told[0]):
                assert w[64 + k] == pytest.approx(told[0], rel=2e-5)
                good += 1
    assert 50 < good < 900


def test_times_stay_between_their_bounds():
    """The sooner the cheaper, here: the first time that is allowed."""
    powers = (1.0, 2.0)
    state = np.array([[-200.0, 40.0, 260.0], [14.0, -3.0, -12.0]])
    asked = np.array([[0.0, 0.0, -2.0], np.zeros(3)])
    targets = np.column_stack((np.linspace(-60.0, 60.0, 20), np.zeros((20, 2))))
    given = np.array([1.62, 1480.0, 3050.0, 0.0, 1e9, 1e9, -1e9, 1e9])
    for first, last in ((45.0, 80.0), (30.0, 60.0)):
        out = np.empty((20, 4))
        kernels.search_sites(
            state, targets, asked, np.full(20, first), np.full(20, last), 14,
            table_of(powers, 8), table_of(powers, 24), np.array(powers), given, out,
        )  # fmt: skip
        reached = np.isfinite(out[:, 0])
        assert reached.sum() > 10
        assert (out[reached, 1] >= first * (1.0 - 1e-12)).all()
        assert (out[reached, 1] <= last * (1.0 + 1e-12)).all()
        assert out[reached, 1] == pytest.approx(np.full(reached.sum(), first), rel=1e-12)


def test_a_limit_within_rounding_of_a_path_does_not_lose_the_site():
    """The greatest thrust of a time that is tried is the limit, less a billionth."""
    powers, samples = (1.0, 2.0), 24
    r, v = np.array([-200.0, 40.0, 260.0]), np.array([14.0, -3.0, -12.0])
    target, v_f, a_f = np.zeros((1, 3)), np.array([0.0, 0.0, -2.0]), np.zeros(3)
    first, last, table = np.array([26.0]), np.array([60.0]), table_of(powers, samples)
    asked = np.array([v_f, a_f])
    doubted = 0
    for at in np.linspace(0.0, 1.0, 14)[1:8]:
        time = float(first[0] * (last[0] / first[0]) ** at)
        free = plain.best(r, v, target[0], v_f, a_f, [time], samples, 1.62, 1480.0, 3050.0, 0.0,
                          1e9, 1e9, -1e9, 1e9, powers)  # fmt: skip
        for less in (1e-9, 3e-9, 1e-8, 3e-8, 1e-7):
            most = free[2] * (1.0 - less)
            given = np.array([1.62, 1480.0, 3050.0, 0.0, most, 1e9, -1e9, 1e9])
            out = np.empty((1, 4))
            kernels.search_sites(
                np.array([r, v]), target, asked, first, last, 14, table, table, np.array(powers),
                given, out,
            )  # fmt: skip
            assert np.isfinite(out[0, 0])
            assert out[0, 2] <= most
            doubted += out[0, 1] > time
    assert doubted > 0
