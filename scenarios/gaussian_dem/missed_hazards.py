"""Count hazards that the Gaussian DEM misses from 1000 m.

The study changes one property of the scans of Table 6 of the Gaussian DEM paper at a time.

python scenarios/gaussian_dem/missed_hazards.py --fields 8
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from computed import truth_of
from rich.table import Table
from scipy.spatial import cKDTree
from testbed import CONFIGURATIONS, LANDER, MARGIN, growth, map_testbed, prior_of_growth, testbed

from lunarsim.evaluation.map_quality import MapQuality
from lunarsim.evaluation.statistics import mean_interval
from lunarsim.safety import stochastic_safety
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.studies import Case, Report, Study, run_script


@dataclass(frozen=True)
class ScanVariant:
    """One changed property of the testbed scans from 1000 m.

    `testbed_changes` and `lidar_changes` are changed arguments of `testbed` and `FlashLidar`;
    `growth` is sigma_f^2 / length_scale of the prior, m; `assumed_sigma` is the standard deviation
    of a return that the DEM assumes, m (None: the true one).
    """

    testbed_changes: dict[str, Any] = field(default_factory=dict)
    lidar_changes: dict[str, Any] = field(default_factory=dict)
    growth: float = growth(MARGIN)
    assumed_sigma: float | None = None


VARIANTS = {
    "as in Table 6": ScanVariant(),
    "no noise": ScanVariant(lidar_changes={"noise_ratio": 0.0}),
    "no noise, its sigma stated": ScanVariant(
        lidar_changes={"noise_ratio": 0.0}, assumed_sigma=0.1 / 3.0
    ),
    "half the spacing": ScanVariant(lidar_changes={"rows": 512, "cols": 512}),
    "twice the spacing": ScanVariant(lidar_changes={"rows": 128, "cols": 128}),
    "1.5 x sigma_f^2 / length": ScanVariant(growth=1.5 * growth(MARGIN)),
    "rocks of 0.8 m": ScanVariant(testbed_changes={"diameter": 0.8}),
    "rocks of 1.5 m": ScanVariant(testbed_changes={"diameter": 1.5}),
    "250 rocks": ScanVariant(testbed_changes={"rocks": 250}),
    "1000 rocks": ScanVariant(testbed_changes={"rocks": 1000}),
}


def count_missed_sites(case: Case) -> list[dict[str, Any]]:
    """Count unsafe sites called safe in one testbed, for each of three scan angles.

    The columns "seen" and "unseen" count unsafe sites with and without a LiDAR return above the
    roughness limit nearby; "..._called_safe" those of them that the map calls safe.
    """
    variant, seed = VARIANTS[case["scans"]], case.seed + case.number
    own = testbed(seed, **variant.testbed_changes)
    setting = prior_of_growth(variant.growth)
    rows = []
    for n, (distance, angle) in enumerate(CONFIGURATIONS[-3:]):
        rng = np.random.default_rng([seed, n])
        lidar = FlashLidar(**variant.lidar_changes)
        one = map_testbed(
            own, distance, angle, rng, lidar=lidar, assumed_sigma=variant.assumed_sigma, **setting
        )
        safety = stochastic_safety(one.dem.mean, one.dem.variance, one.grid, LANDER)
        use = safety.observed & own.safety.observed[one.window]
        called = safety.p_roughness[use] > 0.5
        safe = truth_of(own, one)["roughness"][use]
        quality = MapQuality.of(called, safe)
        # The plane of the testbed is at height 0: a return above the limit comes from a rock.
        high = one.points[one.points[:, 2] > LANDER.roughness_limit, :2]
        distances, _ = cKDTree(high).query(one.grid.centres()[use][~safe])
        seen, wrong = distances < LANDER.leg_radius, called[~safe]
        rows.append({
            "angle_deg": angle, "unsafe_fraction": 1.0 - quality.safe_share,
            "precision": quality.precision, "recall": quality.recall,
            "seen": int(seen.sum()), "seen_called_safe": int(wrong[seen].sum()),
            "unseen": int((~seen).sum()), "unseen_called_safe": int(wrong[~seen].sum()),
        })  # fmt: skip
    return rows


def print_misses(report: Report) -> None:
    """Print the missed hazards of each scan variant and angle over all testbeds."""
    count = len(report.groups("number"))
    table = Table(
        title=f"Roughness safety from 1000 m at p > 0.5, {count} testbeds, 95 % intervals"
    )
    for heading in ("angle\n(deg)", "scans", "truly unsafe\n(fraction)", "precision", "recall",
                    "unsafe sites\ncalled safe", "of these, without a\nreturn above the limit",
                    "called safe, with a\nreturn above the limit",
                    "called safe, without\nsuch a return"):  # fmt: skip
        table.add_column(heading, justify="right")
    groups = sorted(report.groups("angle_deg", "scans").items(), key=lambda group: group[0][0])
    for (angle, scans), rows in groups:
        seen, seen_called, unseen, unseen_called = (
            sum(row[name] for row in rows)
            for name in ("seen", "seen_called_safe", "unseen", "unseen_called_safe")
        )
        called = seen_called + unseen_called
        fractions = ((called, seen + unseen), (unseen_called, called), (seen_called, seen),
                     (unseen_called, unseen))  # fmt: skip
        table.add_row(
            f"{angle:.0f}", scans, f"{report.column('unsafe_fraction', rows).mean():.3f}",
            *(mean_interval(report.column(name, rows)).text() for name in ("precision", "recall")),
            *(f"{part / total:.4f}" if total else "-" for part, total in fractions),
        )  # fmt: skip
    report.print(table)


study = Study(
    count_missed_sites,
    repeats="fields",
    count=4,
    seed=0,
    factors={"scans": list(VARIANTS)},
    factor_help={"scans": "Changed property of the scans."},
    report=print_misses,
)

if __name__ == "__main__":
    run_script(study)
