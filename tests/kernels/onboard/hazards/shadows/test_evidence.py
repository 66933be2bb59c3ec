"""Recording of one observation against a plain loop."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.shadows import _evidence_kernels as kernels
from lunarsim.onboard.hazards.shadows.clear_evidence import ClearEvidence
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.rocks.field import RockField
from lunarsim.world.terrain import Terrain
from tests.shadow_scene import MODEL, SUN, picture
from tests.worlds import flat_terrain

GRID = Grid.centred((0.0, 0.0), 30.0, 0.25)
DIAMETERS = np.array([0.5, 0.6, 0.9, 1.5])
NUMBER = np.array([0.01, 0.005, 0.002, 0.0005])


def level(height=0.0):
    return lambda xy: np.full(len(xy), height)


def viewing_angles(terrain, place):
    state, camera, counts = picture(terrain, place)
    return camera.view(state), detect_rocks(counts, camera, state, SUN, model=MODEL)


@pytest.mark.parametrize(
    ("focal", "way", "height", "cores", "least"),
    [
        pytest.param((70.0, 60.0), (0.1, 0.25, -1.0), 18.0, 1, (26, 3, 5), id="down"),
        pytest.param((70.0, 60.0), (0.1, 0.25, -1.0), 18.0, 2, (26, 3, 5), id="two cores"),
        pytest.param((120.0, 110.0), (0.1, 0.25, -1.0), 18.0, 1, (26, 1, 1), id="narrow"),
        pytest.param((30.0, 24.0), (0.9, 0.5, -0.2), 4.0, 1, (26, 1, 1), id="ahead"),
    ],
)
def test_observation_does_as_a_plain_loop(focal, way, height, cores, least):
    rng = np.random.default_rng(5)
    points = 3 if cores == 1 else 2 * cores
    coarse = rng.normal(0.0, 1.5, (5, 7, 5 + 2 * points))
    coarse[..., 0] = rng.uniform(-0.3, 2.0, coarse.shape[:2])
    # Places that were moved and turned since they were noted.
    col, row = np.meshgrid(2.8 * np.arange(7), 2.8 * np.arange(5))
    coarse[..., 1] = -6.0 + col - 0.1 * row
    coarse[..., 2] = -7.0 + row + 0.1 * col
    coarse[..., 3] *= 0.3
    coarse[..., 4] = rng.uniform(0.0, 1.0, (5, 7)) * (col > 6.0) + 40.0 * (row > 10.0)
    radii = np.array([0.3, 0.8])
    lit, dark_ = (rng.uniform(0.0, 1.2, (2, 15, 22)).astype(np.float32) for _ in range(2))
    known = np.zeros(lit.shape, np.bool_)
    before = lit.copy(), dark_.copy()
    forward = np.array(way) / np.linalg.norm(way)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    axes = np.column_stack((right, np.cross(forward, right), forward))
    position = np.array([3.0, -4.0, height])
    labels = rng.integers(0, 4, (30, 40)).astype(np.int32)
    largest = np.array([0.0, 0.5, np.inf, -0.9], np.float32)
    kernels.record_observation(
        lit, dark_, known, radii, coarse, 4, position, axes, *focal, 19.0, 15.0, labels,
        largest, 2, 1.1, cores,
    )  # fmt: skip
    changed = named = passed = 0
    for s, i, j in product(range(2), range(15), range(22)):
        node = [
            np.interp(j / 4, np.arange(7), coarse[r, :, k])
            for r, k in product(range(5), range(5 + 2 * points))
        ]
        at = [
            np.interp(i / 4, np.arange(5), np.reshape(node, (5, -1))[:, k])
            for k in range(5 + 2 * points)
        ]
        want = [before[0][s, i, j], before[1][s, i, j]]
        if at[0] > 0.0 and at[0] > 1.1 * max(want):
            place = np.array([-6.0 + 0.7 * j - 0.07 * i, -7.0 + 0.7 * i + 0.07 * j, at[3]])
            core = radii[s] * np.reshape(at[5:], (points, 2))

            def dark(higher, place=place, core=core, radius=radii[s]):
                """Return how many points are dark, and of these how many are tracked; or None.

                Of the darkest core; of two as dark that of which fewer are tracked.
                """
                found = np.zeros((cores, 2), np.int64)
                for k, off in enumerate(core):
                    x, y, z = axes.T @ (place + [*off, higher] - position)
                    u, v = focal[0] * x / z + 19.0, focal[1] * y / z + 15.0
                    if not (z > 0.0 and 0.0 <= u <= 39.0 and 0.0 <= v <= 29.0):
                        return None
                    of = labels[int(v + 0.5), int(u + 0.5)]
                    found[k * cores // points] += (
                        abs(largest[of]) >= radius,
                        of == 3 and radius <= 0.9,
                    )
                return max((int(a), -int(b)) for a, b in found)[0], min(
                    int(b) for a, b in found if a == max(found[:, 0])
                )

            found = dark(0.0)
            if found is not None and found[0] >= 2:
                want[1] = at[0]
                changed, named = changed + 1, named + known[s, i, j]
                assert known[s, i, j] == (found[1] > 0.5 * found[0])
            elif found is not None:
                aside = at[4] * np.hypot(*(place - position)[:2]) / (position[2] - place[2])
                steps = int(aside / radii[s] + 0.5)
                far = [dark(at[4] * n / steps) for n in range(-steps, steps + 1) if n]
                if steps <= 16 and all(f is not None and f[0] == f[1] for f in far):
                    want[0] = at[0]
                    changed += 1
                else:
                    passed += 1
        assert [lit[s, i, j], dark_[s, i, j]] == pytest.approx(want, rel=1e-6)
    assert changed < 600
    assert all(np.array([changed, named, passed]) >= least)


@pytest.mark.parametrize("towards", [(0.0, 0.0), (3.0, 0.0), (-3.0, 0.0), (0.0, 3.0), (0.0, -3.0)])
def test_terrain_whose_shadow_would_fall_within_the_image_is_looked_at_to_its_edges(towards):
    """Of rocks of 0.5 m, seen from 10 m straight above; places are 1.8 pixels apart."""
    x, y = np.meshgrid(0.3 * np.arange(61) - 9.1, 0.3 * np.arange(61) - 8.9)
    core = np.broadcast_to(towards, (*x.shape, 2))
    coarse = np.dstack((np.ones_like(x), x, y, 0.0 * x, 0.0 * x, core))
    lit, dark = (np.zeros((1, 60, 60), np.float32) for _ in range(2))
    down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    kernels.record_observation(
        lit, dark, np.zeros(lit.shape, np.bool_), np.array([0.5]), coarse, 1,
        np.array([0.0, 0.0, 10.0]), down, 60.0, 60.0, 19.5, 14.5, np.zeros((30, 40), np.int32),
        np.zeros(1, np.float32), 1, 1.03, 1,
    )  # fmt: skip
    u, v = 6.0 * (x + 0.5 * towards[0]) + 19.5, -6.0 * (y + 0.5 * towards[1]) + 14.5
    shown = (u >= 0.0) & (u <= 39.0) & (v >= 0.0) & (v <= 29.0)
    np.testing.assert_array_equal(lit[0] > 0.0, shown[:-1, :-1])
    assert 300 < shown.sum() < 400


# In the last three the picture of a square that is behind the camera with two corners and beyond an
# edge with two comes in from the other side.
@pytest.mark.parametrize("seed", [*range(12), 472, 987, 1653])
def test_what_is_in_view_is_looked_at_from_wherever_the_camera_stands(seed):
    """Low over rough ground and nearly level: squares reach behind the camera and beyond edges."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(3.0 * np.arange(6) - 7.5, 3.0 * np.arange(5) - 6.0)
    height = rng.normal(0.0, 0.8, x.shape)
    coarse = np.dstack((np.ones_like(x), x, y, height, np.zeros((*x.shape, 3))))
    forward = np.append(rng.normal(0.0, 1.0, 2), rng.uniform(-0.6, 0.2))
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.column_stack((right, np.cross(forward, right), forward))
    position = np.append(rng.uniform(-4.0, 4.0, 2), rng.uniform(1.0, 4.0))
    focal = rng.uniform(15.0, 60.0)
    lit, dark = (np.zeros((1, 48, 60), np.float32) for _ in range(2))
    kernels.record_observation(
        lit, dark, np.zeros(lit.shape, np.bool_), np.array([0.3]), coarse, 12, position, axes,
        focal, focal, 19.5, 14.5, np.zeros((30, 40), np.int32), np.zeros(1, np.float32), 1, 1.03,
        1,
    )  # fmt: skip
    at = RegularGridInterpolator((np.arange(5), np.arange(6)), np.dstack((x, y, height)))
    row, col = np.meshgrid(np.arange(48) / 12, np.arange(60) / 12, indexing="ij")
    along = (at(np.stack((row, col), -1)) - position) @ axes
    u, v = (focal * along[..., k] / along[..., 2] + c for k, c in ((0, 19.5), (1, 14.5)))
    shown = (along[..., 2] > 0.0) & (u >= 0.0) & (u <= 39.0) & (v >= 0.0) & (v <= 29.0)
    np.testing.assert_array_equal(lit[0] > 0.0, shown)


def test_shadows_of_round_and_of_long_rocks_are_looked_for(monkeypatch):
    """A long rock's disc is 0.7 of its longer half axis, by which it is a hazard."""
    rocks = RockField.hemispheres([-6.0], [2.0], 0.0, 0.6)
    view, seen = viewing_angles(Terrain(flat_terrain(400.0, 10.0).relief, rocks), (0.0, 0.0, 35.0))
    told = []
    monkeypatch.setattr(kernels, "record_observation", lambda *given: told.append(given))
    evidence = ClearEvidence(GRID, MODEL, DIAMETERS, NUMBER, DetectionRates())
    evidence.add_image(view, SUN, seen, level())
    coarse, cores = told[0][4], told[0][-1]
    assert cores == 2 and coarse.shape[2] == 5 + 2 * 5 * cores
    np.testing.assert_allclose(coarse[..., 15:], 0.7 * coarse[..., 5:15], rtol=1e-12)
    assert np.ptp(coarse[..., 5:15]) > 0.3
