"""Gaussian DEM scripts on small cases."""

from __future__ import annotations

import re

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.studies import report_study, run_study
from lunarsim.studies.command import study_command


def test_configurations_are_those_of_table_4(script, capsys):
    study = script("gaussian_dem", "tables").study
    rows = run_study(study, count=2, levels={"table": ["4"]})
    assert len(rows) == 9
    assert rows[3]["values"][0] == pytest.approx(100.0, abs=1.1)
    assert rows[8]["values"][2] == pytest.approx(1.611, abs=0.02)
    report_study(study, rows)
    assert "scan configurations (ours / paper)" in capsys.readouterr().out


@pytest.mark.slow
def test_table_3_has_no_false_safe_cell(script, tmp_path):
    study, options = script("gaussian_dem", "tables").study, {"figures": True}
    rows = run_study(study, levels={"table": ["3"]}, options=options)
    assert all(row["false_safe"] == 0 for row in rows)
    recall = [row["recall"] for row in rows]
    assert recall == sorted(recall, reverse=True)
    assert min(row["bounded"] for row in rows if row["c"] <= 0.5) > 0.8
    report_study(study, rows, options=options, out=tmp_path)
    assert (tmp_path / "figure_12_conservativeness.png").exists()


@pytest.mark.slow
def test_table_5_beats_the_paper_everywhere(script, capsys):
    """It is also better than the baseline at the best phase of its grid."""
    study = script("gaussian_dem", "tables").study
    report_study(study, run_study(study, levels={"table": ["5"]}))
    assert len(re.findall(r"yes │ +yes │", capsys.readouterr().out)) == 9


def test_unknown_table_is_refused(script):
    command = study_command(script("gaussian_dem", "tables").study)
    done = CliRunner().invoke(command, ["--table", "9"])
    assert done.exit_code == 2
    assert "Traceback" not in done.output


def test_sampled_terrain_errors_match_the_map_variance(tmp_path, script, capsys):
    study = script("gaussian_dem", "monte_carlo")
    for configuration in (1, 3):
        dem = study.scan_testbed(configuration, 0)[1].dem
        ratio = [
            (
                study.error_field(configuration, 0, np.random.default_rng([9, n])) ** 2
                / dem.variance
            )[dem.observed].mean()
            for n in range(3)
        ]
        assert np.mean(ratio) == pytest.approx(1.0, abs=0.08)
    rows = run_study(study.study, count=2)
    report_study(study.study, rows, out=tmp_path)
    assert capsys.readouterr().out.count("support planes") == 4
    assert (tmp_path / "monte_carlo.png").stat().st_size > 20_000
    assert CliRunner().invoke(study_command(study.study), ["--samples", "0"]).exit_code == 2


def test_map_testbed_returns_scan_and_dem_on_the_evaluated_cells(script):
    bed = script("gaussian_dem", "testbed")
    field = bed.testbed(3, 50.0)
    one = bed.map_testbed(field, 200.0, 30.0, np.random.default_rng(5), **bed.DENSITY)
    points, sigma, shape = bed.scan(field, 200.0, 30.0, np.random.default_rng(5))
    np.testing.assert_array_equal(one.points, points)
    assert (one.sigma, one.shape) == (sigma, shape)
    assert one.grid == bed.view_grid(200.0)
    # The matching truth is closer than the truth shifted by one cell.
    error = one.dem.mean - field.elevation[one.window]
    rows, cols = one.window
    aside = one.dem.mean - field.elevation[rows, cols.start + 2 : cols.stop + 2]
    assert np.nanmean(error**2) < 0.3 * np.nanmean(aside**2)
    few = bed.testbed(3, 20.0, rocks=20, diameter=2.0).terrain.rocks
    assert len(few) == 20
    assert few.height.max() == pytest.approx(1.0)


def test_phase_only_moves_the_baseline_cells(script):
    """On a tilted plane the error is within half a cell; its mean follows the phase."""
    computed = script("gaussian_dem", "computed")
    grid = Grid.centred((0.0, 0.0), 12.0, 0.1)
    x, y = np.meshgrid(np.arange(-8.0, 8.0, 0.05), np.arange(-8.0, 8.0, 0.05))
    points = np.column_stack((x.ravel(), y.ravel(), 0.5 * x.ravel()))
    inner = np.abs(grid.x) < 4.0
    for phase in ((0.0, 0.0), (0.5, 0.0), (0.25, 0.75)):
        coarse, nearest = computed.conventional_dem_cells(points, grid, 0.8, phase)
        error = (coarse.elevation[nearest] - 0.5 * grid.centres()[..., 0])[:, inner]
        # The slope over half a cell, plus a margin for the sample positions.
        assert np.abs(error).max() < 0.5 * 0.4 + 0.05
        assert coarse.grid.centre == pytest.approx((0.8 * phase[0], 0.8 * phase[1]))
    assert len(set(computed.PHASES)) == 16


def test_table_6_counts_each_cell_once_per_map(script, monkeypatch):
    computed = script("gaussian_dem", "computed")
    monkeypatch.setattr(computed, "CONFIGURATIONS", [(200.0, 60.0)])
    monkeypatch.setattr(computed, "SCANS", range(1))
    ((row,), _) = computed.table_6(0)
    one = computed.evaluate_scan(computed.testbed(0), 0, 0)
    seen, truth = one.evaluated, one.truth["roughness"]
    for method, maps in (("proposed", 1), ("baseline", 4)):
        assert np.sum(row["counts"][f"{method} roughness"]) == maps * seen.sum()
        called = np.concatenate([p[seen] > 0.5 for p in one.p[method, "roughness"]])
        safe = np.tile(truth[seen], maps)
        precision, recall = row["at_half"][f"{method} roughness"]
        assert precision == pytest.approx((called & safe).sum() / called.sum())
        assert recall == pytest.approx((called & safe).sum() / safe.sum())


def test_unsafe_sites_are_split_by_returns_above_the_limit(script, monkeypatch, capsys):
    study = script("gaussian_dem", "missed_hazards")
    monkeypatch.setattr(study, "CONFIGURATIONS", [(1000.0, 60.0)])
    own = study.testbed(1)
    monkeypatch.setattr(study, "testbed", lambda seed, **bed: own)
    rows = run_study(study.study, count=1, seed=1, levels={"scans": ["as in Table 6"]})
    (one,) = rows
    # Rocks without a return are more often called safe.
    missed = one["unseen_called_safe"] / one["unseen"]
    assert missed > 3.0 * one["seen_called_safe"] / one["seen"]
    # The same split by raster distances, accurate to half a cell.
    rng = np.random.default_rng([1, 0])
    setting = study.prior_of_growth(study.growth(study.MARGIN))
    scan = study.map_testbed(own, 1000.0, 60.0, rng, **setting)
    low = np.ones(scan.grid.shape, np.bool_)
    high = scan.points[scan.points[:, 2] > 0.25, :2]
    row, col = scan.grid.cell(high[scan.grid.contains(high)])
    low[row, col] = False
    safe = study.truth_of(own, scan)["roughness"]
    seen = study.stochastic_safety(scan.dem.mean, scan.dem.variance, scan.grid, study.LANDER)
    judged = seen.observed & own.safety.observed[scan.window] & ~safe
    assert one["seen"] + one["unseen"] == judged.sum()
    called = one["seen_called_safe"] + one["unseen_called_safe"]
    assert called == (seen.p_roughness[judged] > 0.5).sum()
    shown = 0.1 * ndimage.distance_transform_edt(low)[judged] < study.LANDER.leg_radius
    assert one["seen"] == pytest.approx(shown.sum(), rel=0.02)
    report_study(study.study, rows)
    assert "as in Table 6" in capsys.readouterr().out


def test_random_field_is_swept_over_both_tables(script, tmp_path, capsys):
    study = script("gaussian_dem", "prior_sweep")
    paper = [
        [p5[1], p5[3], 0.0, p6[1], p6[3], p6[5], p6[7]]
        for p5, p6 in zip(study.PAPER_5, study.PAPER_6, strict=True)
    ]
    found = np.tile(paper, (len(study.GROWTHS), 1, 1))
    found[3:, 2, study.METRICS.index("nlpd")] += 0.1
    found[2, 5, study.METRICS.index("recall slope")] -= 0.1
    values = {name: found[:, :, i] for i, name in enumerate(study.METRICS)}
    count = study.count_scans_as_published(values)
    assert count["NLPD"].tolist() == [9, 9, 9] + [8] * (len(study.GROWTHS) - 3)
    assert count["recall slope"][:4].tolist() == [9, 9, 8, 9]
    rows = [{"number": 0, **dict(zip(study.METRICS, one, strict=True))}
            for one in found.reshape(-1, len(study.METRICS))]  # fmt: skip
    report_study(study.study, rows, out=tmp_path)
    assert f"both {study.GROWTHS[2]:.1e} m" in capsys.readouterr().out
    assert (tmp_path / "random_field.png").stat().st_size > 20_000
