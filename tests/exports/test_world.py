"""Worlds and point clouds: other readers find the terrain and its rocks where they are."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
import rasterio

from lunarsim.errors import InputError
from lunarsim.exports import export_flight
from lunarsim.exports.world import write_world
from lunarsim.rng import RandomStreams
from lunarsim.rocks.population import RockPopulation
from lunarsim.simulation.worlds import rebuild_world
from lunarsim.world.terrain_models.measured import RasterTerrain
from tests.reference.glb import read_glb
from tests.worlds import long_terrain


@pytest.fixture(scope="module")
def terrain(flight):
    return rebuild_world(flight).terrain


@pytest.fixture(scope="module")
def strange():
    """Terrain that is longer than wide, off the origin, with a hole."""
    return long_terrain(np.random.default_rng(1))


def test_a_geotiff_has_the_elevation_at_each_place(flight, terrain, tmp_path):
    path = export_flight(flight, "world", tmp_path / "world.tif")
    rng = np.random.default_rng(2)
    grid = terrain.relief.grid
    xy = np.column_stack((rng.choice(grid.x, 200), rng.choice(grid.y, 200)))
    with rasterio.open(path) as file:
        assert (file.count, file.units[0]) == (1, "m")
        assert 'UNIT["metre",1' in file.crs.to_wkt()
        found = np.array([value[0] for value in file.sample(xy)])
    np.testing.assert_allclose(found, terrain.elevation(xy), atol=1e-5)


def test_a_geotiff_of_strange_terrain(strange, tmp_path):
    write_world(strange, tmp_path / "a.tif")
    grid = strange.relief.grid
    with rasterio.open(tmp_path / "a.tif") as file:
        assert (file.height, file.width) == grid.shape and np.isnan(file.nodata)
        rows = file.read(1)
        assert np.isnan(rows).sum() == np.isnan(strange.raster(grid)).sum() > 0
        x, y = file.xy(0, 0)
    assert (x, y) == pytest.approx((grid.x[0], grid.y[-1]))
    assert rows[0, 3] == strange.raster(grid)[-1, 3]


def test_a_scenario_flies_over_the_geotiff(terrain, tmp_path):
    """Without rocks, the exported terrain read again is the same relief about its mean."""
    write_world(terrain, tmp_path / "a.tif", has_rocks=False)
    model = RasterTerrain(
        path=tmp_path / "a.tif", posting=terrain.relief.grid.posting, detail=False
    )
    again = model.build(RockPopulation(cover=0.0), RandomStreams(np.random.SeedSequence(1)))
    z = terrain.relief.z
    assert again.relief.grid.shape == terrain.relief.grid.shape
    np.testing.assert_allclose(again.relief.z, z - z.mean(), atol=1e-4)
    assert again.relief.grid.x0 == pytest.approx(terrain.relief.grid.x0, abs=1e-6)


def upward(vertices, faces):
    """Return the vertical component of the normals of triangles, not normalised."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)[:, 2]


def on_surface(terrain, vertices):
    """Return the elevation of terrain just inside of the vertices."""
    return terrain.elevation(vertices[:, :2])


@pytest.mark.parametrize("kind", ["ply", "glb"])
def test_meshes_have_terrain_and_rocks(flight, terrain, tmp_path, kind):
    path = export_flight(flight, "world", tmp_path / f"world.{kind}")
    points = terrain.relief.z.size
    if kind == "ply":
        mesh = meshio.read(path)
        vertices, faces = mesh.points.astype(float), mesh.cells_dict["triangle"].astype(int)
        ground, stones = vertices[:points], vertices[points:]
        ground_faces = faces[(faces < points).all(axis=1)]
        stone_faces = faces[(faces >= points).all(axis=1)] - points
        assert len(ground_faces) + len(stone_faces) == len(faces)
    else:
        parts = read_glb(path.read_bytes())
        assert set(parts) == {"terrain", "rocks"}
        # glTF has y up: east, up, south.
        to_enu = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        (ground, ground_faces), (stones, stone_faces) = (
            (parts[name][0] @ to_enu, parts[name][1]) for name in ("terrain", "rocks")
        )
    grid = terrain.relief.grid
    assert len(ground) == points and len(ground_faces) == 2 * (grid.rows - 1) * (grid.cols - 1)
    np.testing.assert_allclose(ground[:, 2].reshape(grid.shape), terrain.relief.z, atol=1e-5)
    np.testing.assert_allclose(ground[0, :2], (grid.x0, grid.y0), atol=1e-5)
    np.testing.assert_allclose(ground[grid.cols - 1, 0], grid.x[-1], atol=1e-5)
    assert (upward(ground, ground_faces) > 0.0).all()
    _check_rocks(terrain, stones, stone_faces)


def _check_rocks(terrain, stones, faces):
    """Check that triangles of rocks that face up lie on the surface of the simulated terrain."""
    up = upward(stones, faces)
    assert (up > -1e-6).all()  # the rocks are open below, and have no overhang
    middles = stones[faces].mean(axis=1)[up > 1e-6]
    z = terrain.elevation(middles[:, :2])
    ground = z - middles[:, 2]
    # Facets of curved rocks lie inside; below the ground, facets are hidden.
    assert (ground > -1e-4).mean() > 0.999
    visible = middles[:, 2] > terrain.relief.z.max()
    assert visible.sum() > 20
    assert np.median(np.abs(ground[visible])) < 0.03
    centres = np.column_stack((terrain.rocks.x, terrain.rocks.y))
    top = terrain.rocks.base + terrain.rocks.height
    for k in np.argsort(-terrain.rocks.height)[:20]:
        near = np.hypot(*(stones[:, :2] - centres[k]).T) < 1.5 * terrain.rocks.a[k]
        assert stones[near, 2].max() == pytest.approx(top[k], abs=2e-3)


def test_a_mesh_has_a_hole_where_the_elevation_is_unknown(strange, tmp_path):
    write_world(strange, tmp_path / "a.ply", has_rocks=False)
    mesh = meshio.read(tmp_path / "a.ply")
    rows, cols = strange.relief.grid.shape
    assert len(mesh.cells_dict["triangle"]) == 2 * ((rows - 1) * (cols - 1) - 4)
    assert np.isfinite(mesh.points).all()


def test_posting(terrain, tmp_path):
    assert write_world(terrain, tmp_path / "a.tif", 1.0) == 60 * 60
    with rasterio.open(tmp_path / "a.tif") as file:
        x, y = file.xy(7, 3)
        assert file.res == (1.0, 1.0)
        assert file.read(1)[7, 3] == pytest.approx(float(terrain.elevation([x, y])), abs=1e-5)
    for posting in (0.0, -1.0, np.nan, np.inf, 1e-4, 100.0):
        with pytest.raises(InputError, match="--posting: must"):
            write_world(terrain, tmp_path / "b.tif", posting)
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]


def test_meshes_need_the_extra(terrain, tmp_path, monkeypatch):
    monkeypatch.setattr("lunarsim.exports.world.find_spec", lambda name: None)
    with pytest.raises(InputError, match="Install the extra `mesh`"):
        write_world(terrain, tmp_path / "a.glb")
    write_world(terrain, tmp_path / "a.tif")
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]


def test_a_point_cloud_lies_on_the_true_terrain(flight, terrain, tmp_path):
    path = export_flight(flight, "pointcloud", tmp_path / "scans.ply")
    cloud = meshio.read(path)
    assert len(cloud.points) == len(flight.scans)
    np.testing.assert_array_equal(cloud.point_data["time"], flight.scans[:, 3].astype(float))
    error = cloud.points[:, 2] - terrain.elevation(cloud.points[:, :2])
    assert np.nanmedian(np.abs(error)) < 0.2
    # The onboard points have the error of the estimated position.
    time, table = flight.scans[:, 3], flight.trajectory
    for axis in range(3):
        name = "xyz"[axis]
        shift = np.interp(
            time, table["time"], table[f"estimated_{name}"] - table[f"position_{name}"]
        )
        np.testing.assert_allclose(cloud.points[:, axis], flight.scans[:, axis] - shift, atol=1e-4)
