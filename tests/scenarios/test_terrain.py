"""Terrain scripts on small cases."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.grid import Grid
from lunarsim.scenario import Scenario
from lunarsim.studies import run_study, unpack_array
from lunarsim.world.terrain import Heightfield
from tests.conftest import SCENARIOS


def test_gallery_renders_a_scene_and_fits_the_rocks(script, tmp_path):
    gallery = script("terrain", "gallery")
    for scene in ("hirise", "rocks"):
        done = CliRunner().invoke(gallery.main, ["--only", scene, "--out", str(tmp_path)])
        assert done.exit_code == 0, done.output
    assert (tmp_path / "hirise.png").stat().st_size > 20_000
    assert (tmp_path / "rock_sizes.png").exists()


def test_differences_separate_slope_and_curvature(script):
    """For z = a x + b y^2: first a L and b (2 y L + L^2), second 0 and 2 b L^2."""
    study = script("terrain", "structure")
    grid = Grid.centred((0.0, 0.0), 20.0, 0.5)
    x, y = grid.centres()[..., 0], grid.centres()[..., 1]
    box = (-8.0, 8.0, -8.0, 8.0)
    tilted = Heightfield(grid, (0.4 * x).astype(np.float32))
    first, second = study.rms_differences(tilted, 2.0, box)
    assert first == pytest.approx(0.8 / np.sqrt(2.0), rel=1e-5)
    assert second < 1e-5
    bowl = Heightfield(grid, (0.1 * y**2).astype(np.float32))
    assert study.rms_differences(bowl, 2.0, box)[1] == pytest.approx(0.8 / np.sqrt(2.0), rel=1e-4)
    assert np.isnan(study.rms_differences(tilted, 0.25, box)).all()


def test_detail_of_apollo_15_continues_the_relief(script, tmp_path):
    """On a part of the plain, no scale below the posting is smooth."""
    study = script("terrain", "structure")
    part = Scenario.load(SCENARIOS / "apollo15.toml").changed(
        terrain={"dtm_window": (60, 140, 20, 100)}
    )
    assert part.terrain.detail
    part.save(tmp_path / "part.toml")
    arguments = ["--scenario", str(tmp_path / "part.toml"), "--box", "-70", "70", "-70", "70"]
    files = ["--out", str(tmp_path), "--json", str(tmp_path / "part.json")]
    done = CliRunner().invoke(study.main, arguments + files)
    assert done.exit_code == 0, done.output
    data = json.loads((tmp_path / "part.json").read_text())
    lag = np.array(data["lag"])
    detail, refined = (np.array(data[n])[:, 1] / lag for n in ("with detail", "refined"))
    assert refined[0] < 0.3 * refined[lag == 8.0][0]
    assert np.ptp(np.log(detail[lag <= 8.0])) < np.log(2.0)
    assert (tmp_path / "structure_part.png").stat().st_size > 20_000
    other = ["--scenario", str(SCENARIOS / "golombek.toml")]
    assert CliRunner().invoke(study.main, other).exit_code == 2


def test_shadows_are_measured_along_the_sun(script):
    """Dark strips of known length along and across the shadows' direction."""
    study = script("terrain", "compare_with_nac")
    along = study.SHADOWS / np.hypot(*study.SHADOWS)
    rows, columns = np.indices((study.SIDE, study.SIDE))
    east, north = study.SAMPLE * (columns - 200), -study.LINE * (rows - 200)
    u, v = east * along[0] + north * along[1], north * along[0] - east * along[1]
    flat = np.ones((study.SIDE, study.SIDE))
    flat[(np.abs(u) < 6.0) & (np.abs(v) < 1.5)] = 0.1
    flat[(np.abs(u - 50.0) < 1.5) & (np.abs(v) < 6.0)] = 0.1
    lengths = np.sort(study.shadow_lengths(flat))
    assert lengths == pytest.approx([3.0, 12.0], abs=1.0)
    distance, auto = study.correlation(flat)
    assert auto[:, 0] == pytest.approx(1.0, abs=1e-6)
    assert distance[1] == 0.5


def test_spectrum_keeps_the_variance_of_white_noise(script):
    study = script("terrain", "compare_with_nac")
    noise = 1.0 + 0.1 * np.random.default_rng(0).standard_normal((study.SIDE, study.SIDE))
    _, power = study.spectrum(noise)
    # Equal in every ring: variance times pixel area; the first ring has few waves.
    assert power[1:] == pytest.approx(0.01 * study.SAMPLE * study.LINE, rel=0.4)
    assert power[6:] == pytest.approx(0.01 * study.SAMPLE * study.LINE, rel=0.1)


@pytest.mark.slow
def test_rendered_images_are_close_to_the_real_image(script):
    study = script("terrain", "compare_with_nac")
    rows = run_study(study.study, seed=7, options={"terrain": ("highland", "golombek")})
    found = {row["image"]: row for row in rows}
    spread, length = study.smooth_area_statistics(unpack_array(rows[0]["pixels"]))
    assert spread == pytest.approx(0.056, abs=0.002)
    assert length == pytest.approx(4.2, abs=1.0)
    real = found.pop("real")
    assert real["mean"] == pytest.approx(0.104, abs=0.002)
    for name in ("highland", "golombek"):
        plain, full = found[f"{name}, plain"], found[f"{name}, full"]
        assert full["histogram_distance"] < 0.05
        assert full["histogram_distance"] < plain["histogram_distance"]
        assert abs(full["slope"] - real["slope"]) < abs(plain["slope"] - real["slope"])
        assert abs(full["slope"] - real["slope"]) < 1.1
        assert 0.5 < full["spread"] / real["spread"] < 2.0
        assert 0.4 < full["length_median_m"] / real["length_median_m"] < 2.5
        assert 0.4 < full["length_90_m"] / real["length_90_m"] < 2.5
    cratered = found["highland, full"]
    for key in ("half_along_m", "half_across_m"):
        assert 0.5 <= cratered[key] / real[key] <= 2.0
    assert abs(cratered["slope"] - real["slope"]) < 0.5
