"""Measure how often a wrong fit of a LiDAR scan to a prior map is accepted.

Wrong fits are local minima. No flight is simulated: single flashes (LiDAR scans), wide and narrow,
from heights of 100 to 400 m at slants of 30 to 80 deg, over the terrains of `map_localisation.py`.
The fits start from random errors of position, attitude and scanner with the assumed covariance. A
fit is wrong if, after the update, the center of the scan has an error of more than half a grid
spacing and of more than five of its standard deviations, east or north.
`is_good_fit` decides which fits are accepted. The filter gate, with which
`MapMatcher` rejects more fits, is not applied.

python scenarios/navigation/scan_fits.py --worlds 50 --jobs 2
"""

from __future__ import annotations

from typing import Any

import numpy as np
from map_localisation import UPRIGHT, make_craters, make_hazard_field
from rich.table import Table

from lunarsim import Grid
from lunarsim.api import State, gimbal_mount
from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.onboard.navigation.corrected_scan import MIN_SCANNER_SIGMAS, CorrectedScan
from lunarsim.onboard.navigation.map_features import MODEL_SIGMA_M, MapFeatures
from lunarsim.onboard.navigation.registration import is_good_fit, register_scan
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.studies import Case, Proportion, Report, Study, run_script
from lunarsim.world.survey import simulate_survey

GROUNDS = {"objects": make_hazard_field, "craters": make_craters}
SIGMAS = (0.3, 1.0, 2.0)  # position, 1 sigma per axis, m
STALE = (0.0, 0.2)
POSTINGS = (0.5, 1.0)
TURN = np.deg2rad(0.1)
LIDARS = (FlashLidar(128, 128, 0.0131, 5e-5), FlashLidar(128, 128, 0.1, 5e-5))
PER_WORLD = 20
MAX_ERROR_SIGMA = 5.0  # standard deviations


def simulate_fits(case: Case) -> list[dict[str, Any]]:
    """Fit simulated LiDAR scans to a map of one terrain; evaluate each fit.

    A row has the initial position error `sigma` (1 sigma per axis, m), whether the fit was
    accepted, whether an accepted fit is wrong, and whether it reduces the position uncertainty by a
    fifth or more (`informative`).
    """
    terrain, posting, outdated = case["terrain"], case["posting"], case["outdated"]
    index = list(GROUNDS).index(terrain)
    rng = np.random.default_rng(
        [case.seed, index, round(10 * posting), round(10 * outdated), case.number]
    )
    world = GROUNDS[terrain](rng)
    grid = Grid.centred((0.0, 0.0), 300.0, posting)
    sigma = 0.1 if posting < 1.0 else 0.3
    prior = simulate_survey(world.terrain, grid, rng, sigma=sigma, outdated_fraction=outdated)
    features = MapFeatures(prior)
    variance = np.full(grid.shape, 2.0 * prior.sigma**2 + MODEL_SIGMA_M**2)
    out = []
    for n in range(PER_WORLD):
        place_sigma = SIGMAS[n % len(SIGMAS)]
        sigmas = np.array([*[place_sigma] * 3, *[TURN] * 3, *MIN_SCANNER_SIGMAS])
        error = sigmas * rng.standard_normal(11)
        seen = simulate_scan(world, rng, error)
        result, _ = register_scan(seen, features, np.diag(sigmas**2), variance)
        fit = evaluate_fit(seen, error, sigmas, result, is_good_fit(result), posting)
        out.append(
            {
                "sigma": place_sigma,
                **dict(zip(("accepted", "wrong", "informative"), fit, strict=True)),
            }
        )
    return out


def simulate_scan(world, rng: np.random.Generator, error: np.ndarray) -> CorrectedScan:  # type: ignore[no-untyped-def]
    """Simulate a LiDAR scan of a random place with an erroneous state estimate.

    Adding `error` (11,) to the state corrects it: position (3, m), attitude (3, rad), scanner (5).
    """
    aim = np.append(rng.uniform(-50.0, 50.0, 2), 0.0)
    height, slant = rng.uniform(100.0, 400.0), np.deg2rad(rng.uniform(30.0, 80.0))
    heading = rng.uniform(-np.pi, np.pi)
    away = height / np.tan(slant) * np.array([np.cos(heading), np.sin(heading)])
    position = np.append(aim[:2] + away, height)
    mount = gimbal_mount(UPRIGHT, aim - position)
    state = State(position, np.zeros(3), UPRIGHT, np.zeros(3), 1.0)
    scan = LIDARS[int(rng.integers(len(LIDARS)))].measure(world, state, 0.0, rng, mount)
    attitude = quat_multiply(UPRIGHT, quat_from_rotation_vector(-error[3:6]))
    seen = CorrectedScan(scan, position - error[:3], attitude, np.zeros(3), np.zeros(3))
    # The scanner error has the opposite sign.
    return seen.corrected_by(np.concatenate((np.zeros(6), -error[6:10], [0.0])))


def evaluate_fit(scan, error, sigmas, result, accepted, posting):  # type: ignore[no-untyped-def]
    """Return whether a scan-to-map fit is accepted, wrong, and informative.

    `scan` is the scan, `error` (11,) its true state error and `sigmas` (11,) the assumed standard
    deviations. `result` is the fit, `accepted` the decision on it and `posting` the grid spacing of
    the map (m). Only accepted fits count as wrong or informative.
    """
    before = np.diag(sigmas**2)
    both = np.eye(11) + result.information @ before
    found = before @ np.linalg.solve(both, result.vector)
    after = before @ np.linalg.inv(both)
    points = scan.points()
    middle = np.nanmean(points, axis=0) if np.isfinite(points).any() else scan.position
    across = scan.point_jacobian(middle)[:2]
    off = np.abs(across @ (error - found))
    own = np.sqrt(np.diag(across @ after @ across.T))
    first = np.sqrt(np.diag(across @ before @ across.T))
    far = (off > 0.5 * posting) & (off > MAX_ERROR_SIGMA * own)
    return accepted, bool(accepted and far.any()), bool(accepted and (own < 0.8 * first).all())


def print_fits(report: Report) -> None:
    """Print the numbers of accepted, informative and wrong fits."""
    table = Table(title="Fits of single flashes to a map")
    for heading in ("terrain, posting (m), outdated fraction, position sigma (m)", "fits",
    "accepted",
                    "of these,\ninformative", "wrong [95 % interval]"):  # fmt: skip
        table.add_column(heading, justify="left" if heading.startswith("terrain") else "right")
    groups = report.groups("terrain", "posting", "outdated", "sigma")
    lines = {f"{name} {a:g} {b:g} {c:g}": rows for (name, a, b, c), rows in groups.items()}
    for name, some in {**lines, "all": report.rows}.items():
        accepted = sum(f["accepted"] for f in some)
        wrong = sum(f["wrong"] for f in some)
        low, high = Proportion(wrong, accepted).interval if accepted else (0.0, 1.0)
        table.add_row(
            name, f"{len(some)}", f"{accepted}", f"{sum(f['informative'] for f in some)}",
            f"{wrong} [{low:.4f}, {high:.4f}]",
        )  # fmt: skip
    report.print(table)


study = Study(
    simulate_fits,
    repeats="worlds",
    count=10,
    factors={"terrain": list(GROUNDS), "posting": POSTINGS, "outdated": STALE},
    factor_help={
        "terrain": "Name of a terrain.", "posting": "Grid spacing of the map (m).",
        "outdated": "Fraction of the map that differs from the terrain.",
    },
    report=print_fits,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
