"""The compiled score of paths against looks taken one by one."""

import numba
import numpy as np
import pytest

from lunarsim.onboard.active_perception import _information_kernels as kernels
from tests.reference import seeking as plain

POWERS = np.array([1.0, 2.0])
G = 1.62
R, V = np.array([-420.0, 60.0, 430.0]), np.array([26.0, -4.0, -17.0])
TARGET, SPEED = np.array([3.0, -2.0, 11.2]), np.array([0.0, 0.0, -2.0])
SITE, STANDING = np.array([3.0, -2.0, 0.4]), 0.8
FINE, COARSE = 12, 20


def table(samples):
    left = np.linspace(1.0, 0.0, samples + 1)
    return np.stack((left, left, left**2), axis=1)


def an_eye(rng, *, stations=(), gimbal=180.0, half_field=30.0, highest=380.0, longest=330.0):
    side = 9
    return {
        "axes": (np.linspace(-1.0, 1.0, side), np.linspace(0.0, 1.0, side)),
        "sharp": rng.uniform(0.2, 4.0, (side, side)),
        "open": rng.uniform(0.3, 1.0, (side, side)),
        "astray": rng.uniform(0.0, 4e-5, (side, side)),
        "told": np.sort(rng.uniform(0.0, 1.0, 17)),
        "sharpest": 20.0, "pixel": 1.0 / 400.0, "half_field_deg": half_field, "gimbal_deg": gimbal,
        "longest": longest, "highest": highest, "lowest": 20.0,
        "sun_azimuth": rng.uniform(0.0, 6.0), "stations": tuple(stations),
    }  # fmt: skip


def as_arrays(eyes):
    tables = [
        np.ascontiguousarray([e[n] for e in eyes]) for n in ("sharp", "open", "astray", "told")
    ]
    figures = np.array([
        [
            e["pixel"], e["sharpest"], np.cos(np.radians(e["half_field_deg"])),
            np.cos(np.radians(e["gimbal_deg"])), e["longest"], e["highest"], e["lowest"],
            np.sin(e["sun_azimuth"]), np.cos(e["sun_azimuth"]),
        ]
        for e in eyes
    ])  # fmt: skip
    stations = np.full((len(eyes), 3), np.nan)
    for row, e in zip(stations, eyes, strict=True):
        row[: len(e["stations"])] = e["stations"]
    return tables, figures, stations


def some_nodes(rng, count=7):
    out = [
        {
            "at": np.array([*rng.uniform(-60.0, 60.0, 2), rng.normal(0.0, 2.0)]),
            "weight": rng.uniform(0.0, 1.0), "known": rng.uniform(0.0, 0.3),
            "needs": rng.uniform(0.0, 15.0),
        }
        for _ in range(count)
    ]  # fmt: skip
    out[3]["weight"] = 0.0
    out[1] |= {"at": np.array([20.0, 30.0, 190.0]), "weight": 1.0, "known": 0.0, "needs": 0.0}
    return out


def some_plans(rng, count=40):
    return np.column_stack((
        rng.uniform(25.0, 60.0, count), rng.uniform(-0.8, 0.8, (count, 2)),
        rng.uniform(-0.3, 1.2, count),
    ))  # fmt: skip


def scored(eyes, plans, nodes, vehicle, *, max_final_tilt=0.9, least=45.0):
    tables, figures, stations = as_arrays(eyes)
    out = np.empty((len(plans), 2))
    rows = np.array([[*n["at"], n["weight"], n["known"], n["needs"]] for n in nodes])
    kernels.score_paths(
        np.array([R, V]), TARGET, SPEED, plans, table(FINE), table(COARSE), POWERS,
        np.array(vehicle), np.tan(max_final_tilt), np.array([*SITE, SITE[2] + STANDING, least]),
        rows,
        *tables, figures, stations, out,
    )  # fmt: skip
    return out


def both(rng, eyes, plans, *, limits=(60.0, 900.0, 2.7, 0.1, 2.7), max_final_tilt=0.9, least=45.0):
    nodes = some_nodes(rng)
    vehicle = (G, 200.0, 3050.0, *limits)
    wanted = plain.score(
        R, V, TARGET, SPEED, plans, (FINE, COARSE), vehicle, max_final_tilt, (SITE, STANDING,
        least),
        nodes, eyes,
    )  # fmt: skip
    return scored(eyes, plans, nodes, vehicle, max_final_tilt=max_final_tilt, least=least), wanted


@pytest.mark.parametrize("seed", range(6))
def test_what_paths_let_a_lander_know(seed):
    rng = np.random.default_rng(seed)
    eyes = [an_eye(rng), an_eye(rng, stations=(350.0, 160.0, 40.0), half_field=12.0)]
    eyes = {
        1: eyes[:1],
        2: eyes[1:],
        3: [an_eye(rng, gimbal=70.0), eyes[1]],
        4: [an_eye(rng, longest=120.0)],
        5: [an_eye(rng, highest=250.0) | {"lowest": 120.0}],
    }.get(seed, eyes)
    found, wanted = both(rng, eyes, some_plans(rng))
    assert np.isfinite(wanted[:, 1]).sum() > 5
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(wanted))
    good = np.isfinite(wanted[:, 1])
    assert wanted[good, 0].max() > wanted[good, 0].min() + 0.01
    np.testing.assert_allclose(found[good], wanted[good], rtol=1e-6)
    assert (found[~good, 0] == 0.0).all()


@pytest.mark.parametrize("max_final_tilt", [0.2, 0.3])
def test_what_leans_at_the_end_is_refused(max_final_tilt):
    rng = np.random.default_rng(8)
    plans = some_plans(rng, 90)
    found, wanted = both(rng, [an_eye(rng)], plans, max_final_tilt=max_final_tilt)
    loose, _ = both(np.random.default_rng(8), [an_eye(rng)], plans)
    np.testing.assert_array_equal(np.isfinite(found[:, 1]), np.isfinite(wanted[:, 1]))
    assert 0 < np.isfinite(found[:, 1]).sum() < np.isfinite(loose[:, 1]).sum()


def test_what_leans_where_the_path_ends_is_refused_though_observations_count_down_to_there():
    plans = some_plans(np.random.default_rng(9), 90)
    found, wanted = both(np.random.default_rng(8), [an_eye(np.random.default_rng(1))], plans,
                         max_final_tilt=0.2, least=0.0)  # fmt: skip
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(wanted))
    assert np.isfinite(found[:, 1]).any()


def test_an_altitude_that_is_passed_on_the_way_up_is_past(monkeypatch):
    monkeypatch.setitem(globals(), "R", np.array([-150.0, 20.0, 150.0]))
    monkeypatch.setitem(globals(), "V", np.array([6.0, -1.0, 12.0]))
    rng = np.random.default_rng(6)
    rises = an_eye(rng, stations=(165.0, 80.0), half_field=40.0)
    falls = dict(rises, stations=(80.0,))
    plans = some_plans(rng, 150)
    found, wanted = both(np.random.default_rng(2), [rises], plans)
    only, _ = both(np.random.default_rng(2), [falls], plans)
    assert np.isfinite(found[:, 1]).sum() > 3
    np.testing.assert_allclose(found, wanted, rtol=1e-6)
    np.testing.assert_array_equal(found, only)


def test_terrain_above_the_lander_is_not_seen():
    """Just before it, too, where tables carried on below the horizon would tell all."""
    rng = np.random.default_rng(5)
    eye = an_eye(rng, half_field=89.0)
    eye |= {"sharp": np.full((9, 9), 50.0), "open": np.ones((9, 9)), "astray": np.zeros((9, 9))}
    heights = (500.0, 700.0)
    for up in heights:
        node = {"at": np.array([-150.0, 20.0, up]), "weight": 1.0, "known": 0.1, "needs": 0.0}
        out = scored(
            [eye], some_plans(rng, 60), [node], (G, 200.0, 3050.0, 60.0, 900.0, 2.7, 0.1, 2.7)
        )
        good = np.isfinite(out[:, 1])
        assert good.any()
        np.testing.assert_allclose(out[good, 0], 0.1)


def test_without_observations_nothing_is_known():
    rng = np.random.default_rng(2)
    eye = an_eye(rng)
    node = {"at": np.zeros(3), "weight": 0.0, "known": 0.4, "needs": 0.0}
    vehicle = (G, 200.0, 3050.0, 60.0, 900.0, 2.7, 0.1, 2.7)
    out = scored([eye], some_plans(rng, 20), [node], vehicle)
    assert (out[:, 0] == 0.0).all()
    assert np.isfinite(out[:, 1]).any()


def test_a_time_that_is_none_is_refused():
    rng = np.random.default_rng(3)
    plans = np.array([[np.nan, 0.0, 0.0, 0.0], [-3.0, 0.0, 0.0, 0.0], [40.0, 0.0, 0.0, -2.0]])
    found, wanted = both(rng, [an_eye(rng)], plans)
    assert np.isinf(found[:, 1]).all()
    assert np.isinf(wanted[:, 1]).all()


def test_bits_do_not_depend_on_threads():
    rng = np.random.default_rng(4)
    plans, eyes, nodes = some_plans(rng, 500), [an_eye(rng)], some_nodes(rng)
    results = []
    for threads in (1, numba.config.NUMBA_NUM_THREADS):
        numba.set_num_threads(threads)
        results.append(scored(eyes, plans, nodes, (G, 200.0, 3050.0, 60.0, 900.0, 2.7, 0.1, 2.7)))
    np.testing.assert_array_equal(*results)
