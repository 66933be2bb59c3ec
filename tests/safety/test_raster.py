"""What is ground and what is not, wherever zero lies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards import HazardMap
from lunarsim.safety import (
    alhat_safety,
    bounded_safety,
    conservative_safety,
    exact_safety,
    footprint_of,
    plane_stochastic_safety,
    safe_sites,
    stochastic_safety,
)

LANDER = Lander(leg_radius=1.1, pad_diameter=0.3)
GRID = Grid.centred((0.0, 0.0), 17.0, 0.1, 9.0)
VARIANCE = np.full(GRID.shape, 1e-4)

TESTS = {
    "exact": lambda z: exact_safety(z, GRID, LANDER),
    "decision": lambda z: safe_sites(z, GRID, LANDER),
    "conservative": lambda z: conservative_safety(z, GRID, LANDER),
    "bounded": lambda z: bounded_safety(z, GRID, LANDER),
    "stochastic": lambda z: stochastic_safety(z, VARIANCE, GRID, LANDER),
    "planes": lambda z: plane_stochastic_safety(z, VARIANCE, GRID, LANDER),
    "alhat": lambda z: alhat_safety(z, GRID, LANDER, sigma=0.02),
}
LAYERS = ("slope", "roughness", "safe", "p_slope", "p_roughness", "p_safe", "observed")


def layers(result) -> dict:
    """Every array of a result by name; `safe_sites` returns two without names."""
    if isinstance(result, tuple):
        return dict(zip(("safe", "observed"), result, strict=True))
    return {name: getattr(result, name) for name in LAYERS if hasattr(result, name)}


def lattice(seed: int) -> np.ndarray:
    """Rough, sloping ground with cliffs, heights on a lattice of 2**-20 m."""
    rng = np.random.default_rng(seed)
    z = 0.03 * rng.standard_normal(GRID.shape) + rng.uniform(0.0, 0.2) * GRID.x[None, :]
    z[:, 60:80] += rng.uniform(0.0, 0.5)
    return np.round(z * 2.0**20) / 2.0**20


def footprints_of(row: int, col: int) -> np.ndarray:
    """Sites whose square of the footprint's reach holds a cell."""
    r = footprint_of(LANDER, GRID.posting).reach
    near = np.zeros(GRID.shape, np.bool_)
    near[max(row - r, 0) : row + r + 1, max(col - r, 0) : col + r + 1] = True
    return near


TILE_ROWS, TILE_COLS = 64, 128  # cells that share the height from which theirs are measured


def tile_of(row: int, col: int) -> np.ndarray:
    r0, c0 = row - row % TILE_ROWS, col - col % TILE_COLS
    same = np.zeros(GRID.shape, np.bool_)
    same[r0 : r0 + TILE_ROWS, c0 : c0 + TILE_COLS] = True
    return same


@pytest.mark.parametrize("name", TESTS)
@settings(max_examples=8)
@given(st.integers(0, 10_000), st.integers(-(10**7), 10**7), st.integers(0, 2**20 - 1))
def test_a_lift_changes_no_bit(name, seed, metres, fraction):
    z = lattice(seed)
    a, b = layers(TESTS[name](z)), layers(TESTS[name](z + (metres + fraction / 2.0**20)))
    assert a["observed"].any()
    for layer, values in a.items():
        assert np.array_equal(values, b[layer], equal_nan=values.dtype.kind == "f"), layer


@pytest.mark.parametrize("name", TESTS)
@settings(max_examples=12)
@given(
    st.integers(0, 10_000),
    st.sampled_from([1e3, -5e3, 1e4, 1e5, 1e6, 1e20, -3.4e38, 1e300, np.inf]),
    st.integers(0, GRID.rows - 1),
    st.integers(0, GRID.cols - 1),
)
def test_a_bad_cell_matters_in_its_own_footprints_alone(name, seed, spike, row, col):
    z = lattice(seed)
    a = layers(TESTS[name](z))
    z[row, col] = spike
    b = layers(TESTS[name](z))
    away = ~footprints_of(row, col)
    for layer in {"safe", "observed"} & a.keys():
        assert np.array_equal(a[layer][away], b[layer][away]), layer
    # The spike may be the height that its tile is measured from.
    away &= ~tile_of(row, col)
    for layer, values in a.items():
        nan = values.dtype.kind == "f"
        assert np.array_equal(values[away], b[layer][away], equal_nan=nan), layer


@pytest.mark.parametrize("mark", [np.nan, np.inf, -3.4e38, 1e20, 1e6, -1e6])
@pytest.mark.parametrize("name", TESTS)
def test_marks_of_missing_data_are_unknown_terrain(name, mark):
    z = lattice(1)
    row, col = 40, 100
    z[row : row + 12, col : col + 30] = mark
    got = layers(TESTS[name](z))
    assert not got["observed"][row : row + 12, col : col + 30].any()
    assert not got["observed"][row - 5, col]
    assert got["observed"].any()
    for layer in ("safe", "p_safe"):
        if layer in got:
            assert not got[layer][~got["observed"]].any()


@pytest.mark.parametrize("name", TESTS)
def test_masked_terrain_is_unknown(name):
    z = np.zeros(GRID.shape)
    hole = np.zeros(GRID.shape, np.bool_)
    hole[40:50, 60:80] = True
    got = layers(TESTS[name](np.ma.MaskedArray(z, hole)))
    want = layers(TESTS[name](np.where(hole, np.nan, z)))
    assert not got["observed"][hole].any()
    for layer, values in want.items():
        assert np.array_equal(got[layer], values, equal_nan=values.dtype.kind == "f"), layer


def test_masked_and_infinite_variances_are_unknown():
    z, variance = lattice(2), VARIANCE.copy()
    variance[40, 70] = np.inf
    masked = np.ma.MaskedArray(VARIANCE, variance == np.inf)
    for judge in (stochastic_safety, plane_stochastic_safety):
        plain = judge(z, variance, GRID, LANDER)
        assert not plain.observed[36:45, 66:75].any()
        assert plain.p_safe[40, 70] == 0.0
        assert plain.observed.any()
        assert np.array_equal(judge(z, masked, GRID, LANDER).p_safe, plain.p_safe)


@pytest.mark.parametrize("kind", [np.int16, np.uint8, np.int64, np.float16, np.longdouble, ">f4"])
@pytest.mark.parametrize("name", TESTS)
def test_other_real_numbers_are_heights(name, kind):
    z = np.zeros(GRID.shape)
    z[::9, ::7] = 1.0
    a, b = layers(TESTS[name](z)), layers(TESTS[name](z.astype(kind)))
    for layer, values in a.items():
        assert np.array_equal(values, b[layer], equal_nan=values.dtype.kind == "f"), layer


def test_a_raster_that_may_not_be_written_is_left_alone():
    z = lattice(3)
    z.flags.writeable = False
    before = z.copy()
    assert np.array_equal(exact_safety(z, GRID, LANDER).safe, safe_sites(z, GRID, LANDER)[0])
    assert np.array_equal(z, before)


@pytest.mark.parametrize("name", TESTS)
@pytest.mark.parametrize("kind", [np.complex128, np.bool_, object, "U8", "M8[s]"])
def test_what_is_no_height_is_refused(name, kind):
    with pytest.raises(InputError, match="real numbers"):
        TESTS[name](np.zeros(GRID.shape).astype(np.int64).astype(kind))


@pytest.mark.parametrize("variance", [1e-4, np.full((3, 3), 1e-4), np.full(GRID.shape, 1j)])
def test_variances_of_another_shape_or_kind_are_refused(variance):
    for judge in (stochastic_safety, plane_stochastic_safety):
        with pytest.raises(InputError, match=r"variance"):
            judge(lattice(0), variance, GRID, LANDER)


@pytest.mark.parametrize("heading", [np.nan, np.inf, -np.inf, 1j, "north"])
def test_a_heading_is_finite(heading):
    with pytest.raises(InputError, match="heading"):
        exact_safety(lattice(0), GRID, LANDER, heading=heading)


def test_a_slope_bound_is_sin_or_tan():
    with pytest.raises(InputError, match=r"slope_bound: .*'cos'"):
        stochastic_safety(lattice(0), VARIANCE, GRID, LANDER, slope_bound="cos")


def test_grids_too_small_for_the_lander_are_refused():
    grid = Grid(0.0, 0.0, 0.1, 1, 1)
    for test in (exact_safety, safe_sites, conservative_safety, bounded_safety):
        with pytest.raises(InputError, match="rows and columns, the size of the lander"):
            test(np.zeros((1, 1)), grid, LANDER)
    for test in (stochastic_safety, plane_stochastic_safety):
        with pytest.raises(InputError, match="rows and columns, the size of the lander"):
            test(np.zeros((1, 1)), np.zeros((1, 1)), grid, LANDER)


def test_landers_of_too_many_cells_are_refused():
    for radius, posting in ((1e4, 0.1), (2.35, 1e-4)):
        with pytest.raises(InputError, match="at most 256 grid spacings"):
            footprint_of(Lander(leg_radius=radius), posting)
    assert footprint_of(Lander(leg_radius=1e4), 1e3).reach == 10


@pytest.mark.parametrize("sigma", [np.nan, -1.0, np.inf, -np.inf])
def test_a_dispersion_is_finite_and_not_negative(sigma):
    grid = Grid.centred((0.0, 0.0), 4.0, 0.5)
    hazard_map = HazardMap(grid, np.ones(grid.shape, np.float32), np.ones(grid.shape, np.bool_))
    with pytest.raises(InputError, match="sigma"):
        hazard_map.dispersed_p_safe(sigma)
