"""Data set of optimal descents: read by Minari, checked by the equations of motion."""

from __future__ import annotations

import errno
import importlib.util
import json
import shutil
from contextlib import nullcontext
from dataclasses import replace

import minari
import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.neural_law import (
    MAX_CROSSRANGE_SPEED_M_S,
    MAX_HEIGHT_M,
    MIN_ELEVATION_RAD,
)
from lunarsim.scenario import Scenario


@pytest.fixture
def small(script, monkeypatch):
    """Return the study with small shards."""
    study = script("learning", "optimal_descents")
    monkeypatch.setattr(study, "SHARD", 3)
    return study


def written(study, folder, *options):
    done = CliRunner().invoke(study.main, ["--descents", "7", "--out", str(folder), *options])
    assert done.exit_code == 0, done.output
    return done.output


@pytest.fixture(scope="module")
def kept():
    """Return what `whole` has written."""
    return {}


@pytest.fixture
def whole(small, kept, tmp_path_factory, monkeypatch):
    """Return the folder of seven descents, which all tests share, and what was printed."""
    if not kept:
        folder = tmp_path_factory.mktemp("whole")
        # Written to a relative path, as in the documentation.
        monkeypatch.chdir(folder.parent)
        kept["whole"] = folder, written(small, folder.name)
    return kept["whole"]


def with_shards(whole, folder):
    """Copy the shards of seven descents into a folder."""
    shutil.copytree(whole[0] / "shards", folder / "shards")
    return folder


def episodes(folder):
    data = minari.MinariDataset(folder / "data")
    return [data[k] for k in range(data.total_episodes)]


def test_episodes_obey_the_equations_of_motion(whole):
    folder, output = whole
    scenario = Scenario.from_dict({"name": "check"})
    lander, gravity = scenario.vehicle.make(), scenario.gravity_m_s2
    all_of_them = episodes(folder)
    assert len(all_of_them) == 7
    assert "7 descents" in output
    for one in all_of_them:
        position, velocity, mass = np.split(one.observations, (3, 6), axis=1)
        step = -np.diff(one.infos["time_to_go"])[:, None]
        assert one.infos["time_to_go"][-1] == 0.0
        moved = velocity[:-1] + step * (one.actions - [0.0, 0.0, gravity])
        assert velocity[1:] == pytest.approx(moved, abs=1e-5)
        # The solver satisfies its equations to about 1e-8 of a kilometre.
        assert position[1:] == pytest.approx(
            position[:-1] + 0.5 * step * (velocity[:-1] + velocity[1:]), abs=3e-5
        )
        # The propellant matches the thrust; at a thrust switch it can be slightly larger.
        push = np.linalg.norm(one.actions, axis=1)
        burnt = mass[:-1, 0] * -np.expm1(-push * step[:, 0] / lander.exhaust_velocity)
        assert one.rewards == pytest.approx(np.diff(mass[:, 0]))
        assert -one.rewards.sum() == pytest.approx(burnt.sum(), rel=0.01)
        thrust = push * np.sqrt(mass[:-1, 0] * mass[1:, 0])
        assert thrust.max() < 1.003 * lander.thrust_max
        assert np.linalg.norm(one.observations[-1, :3]) < 1e-4
        assert one.terminations.tolist() == [False] * 39 + [True]
        assert not one.truncations.any()


def test_results_do_not_depend_on_processes_or_interruptions(small, whole, tmp_path):
    whole, broken = whole[0], tmp_path / "broken"
    # Two of three shards exist already.
    (broken / "shards").mkdir(parents=True)
    for file in sorted((whole / "shards").glob("*.npz"))[:2]:
        (broken / "shards" / file.name).write_bytes(file.read_bytes())
    written(small, broken)
    figures = [json.loads((f / "figures.json").read_text()) for f in (whole, broken)]
    assert figures[0] == figures[1]
    tasks = [small.DescentShardTask(k, 3 if k < 2 else 1, 1, 40) for k in range(3)]
    again = small.solve_shard(tasks[1])
    stored = np.load(sorted((whole / "shards").glob("*.npz"))[1])
    assert np.array_equal(again["observations"], stored["observations"])
    other = small.solve_shard(replace(tasks[1], seed=2))
    assert not np.array_equal(other["observations"], stored["observations"])
    assert small.StartDistribution.key(tasks[1]) != small.StartDistribution.key(
        replace(tasks[1], intervals=30)
    )


def test_invalid_requests_are_rejected(small, tmp_path, monkeypatch):
    def refused(*options):
        done = CliRunner().invoke(small.main, [*options])
        assert done.exit_code == 2, done.output
        return done.output

    assert "--out" in refused("--descents", "5")
    assert "'--descents'" in refused("--descents", "0", "--out", str(tmp_path))
    assert "'--intervals'" in refused("--intervals", "3", "--out", str(tmp_path))
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "mine.txt").write_text("kept")
    assert "without a data set" in refused("--out", str(tmp_path))
    assert (tmp_path / "data" / "mine.txt").read_text() == "kept"
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert "the extra `data`" in refused("--out", str(tmp_path / "new"))
    assert not (tmp_path / "new").exists()


def test_interrupt_keeps_finished_shards(small, tmp_path, monkeypatch):
    solve, left = small.solve_shard, [2]

    def broken(task):
        if left[0] == 0:
            raise KeyboardInterrupt
        left[0] -= 1
        return solve(task)

    monkeypatch.setattr(small, "solve_shard", broken)
    done = CliRunner().invoke(small.main, ["--descents", "7", "--out", str(tmp_path)])
    assert done.exit_code == 1
    assert "run the same command again to resume" in done.output
    assert len(list((tmp_path / "shards").glob("*.npz"))) == 2
    assert not (tmp_path / "data").exists()
    left[0] = 1
    output = written(small, tmp_path)
    assert "7 descents" in output


def test_shards_of_other_limits_are_rejected(small, whole, tmp_path, monkeypatch):
    with_shards(whole, tmp_path)
    monkeypatch.setattr(small, "Approach", lambda: replace(Approach(), reserve=20.0))
    done = CliRunner().invoke(small.main, ["--descents", "7", "--out", str(tmp_path)])
    assert done.exit_code == 2, done.output
    assert "other limits" in " ".join(done.output.split())


def test_descents_start_in_the_domain_of_the_law(small):
    starts = small.StartDistribution()
    assert starts.elevation == pytest.approx(np.rad2deg(MIN_ELEVATION_RAD))
    assert starts.height[1] == MAX_HEIGHT_M
    assert starts.across == (-MAX_CROSSRANGE_SPEED_M_S, MAX_CROSSRANGE_SPEED_M_S)


def test_invalid_limits_file_is_rejected(small, tmp_path):
    (tmp_path / "shards").mkdir()
    (tmp_path / "shards" / "problem.json").write_text("{")
    done = CliRunner().invoke(small.main, ["--descents", "7", "--out", str(tmp_path)])
    assert done.exit_code == 2, done.output
    assert "not a valid file of limits" in " ".join(done.output.split())


def test_unwritable_folder_is_reported(small, tmp_path):
    (tmp_path / "file").write_text("")
    done = CliRunner().invoke(
        small.main, ["--descents", "2", "--out", str(tmp_path / "file" / "x")]
    )
    assert done.exit_code == 1, done.output
    assert "--out: " in done.output
    assert "Not a directory" in " ".join(done.output.split())


def test_full_disk_is_reported_and_shards_are_kept(small, whole, tmp_path, monkeypatch):
    def full(*given):
        (given[1] / "main_data.hdf5").write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(small, "write_dataset", full)
    with_shards(whole, tmp_path)
    done = CliRunner().invoke(small.main, ["--descents", "7", "--out", str(tmp_path)])
    assert done.exit_code == 1, done.output
    assert "No space left" in " ".join(done.output.split())
    assert [path.name for path in tmp_path.iterdir()] == ["shards"]


def test_run_killed_while_writing_resumes(small, whole, tmp_path, monkeypatch):
    """A killed run cannot clean up: partial output is not in the data folder."""
    write = small.write_dataset

    def killed(*given):
        write(*given)
        raise SystemExit(9)

    monkeypatch.setattr(small, "write_dataset", killed)
    with_shards(whole, tmp_path)
    monkeypatch.setattr(small, "remove_contents_on_error", lambda folder: nullcontext())
    CliRunner().invoke(small.main, ["--descents", "7", "--out", str(tmp_path)])
    assert not (tmp_path / "data").exists()
    monkeypatch.setattr(small, "write_dataset", write)
    assert "7 descents" in written(small, tmp_path)
    assert len(episodes(tmp_path)) == 7
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data", "figures.json", "shards"]


@pytest.mark.slow
def test_bits_do_not_depend_on_the_number_of_processes(script, tmp_path, monkeypatch):
    study = script("learning", "optimal_descents")
    # Three shards: one process solves all, two processes share them unequally.
    monkeypatch.setattr(study, "SHARD", 20)
    for jobs in ("1", "2"):
        given = ["--descents", "50", "--intervals", "8", "--jobs", jobs]
        done = CliRunner().invoke(study.main, [*given, "--out", str(tmp_path / jobs)])
        assert done.exit_code == 0, done.output
    one, two = ((tmp_path / jobs / "figures.json").read_text() for jobs in ("1", "2"))
    assert one == two
