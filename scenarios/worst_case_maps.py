"""Search for worlds in which p_safe of the Gaussian DEM is far too high.

The score of a world is the precision of its map: the fraction of truly safe sites among those that
the map of one static scan claims with p_safe > 0.95 inside its domain. The search minimises it over
relief, rocks, lander, sensor and view. The onboard inputs are correct: lander, sensor noise, pose,
and the rock distribution ([expected_rocks] equals [rocks]). Random search with as many evaluations
is the baseline. Findings are evaluated on fresh relief, rocks and noise, and shrunk to the keys
that they need; their scenarios are written to the folder of results.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from lunarsim import Grid, InputError, Scenario, Terrain, flight_seed, site_safety
from lunarsim.api import HazardMap, LidarScan, RandomStreams, State
from lunarsim.frames import sensor_axes
from lunarsim.onboard.hazards.gaussian_dem import SamplePool, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.dem_snapshot import DemSnapshot
from lunarsim.scenario.changes import with_changes
from lunarsim.search import ChoiceRange, ContinuousRange, SearchSpace
from lunarsim.studies import Case, Metric, Study, run_script
from lunarsim.studies.worst_case import OPTIONS, WorstCaseProblem
from lunarsim.world import World

CLAIMED_P = 0.95  # claims are sites with a larger p_safe, inside the domain
# A world with fewer claimed sites has no usable precision; its score is above 1.
MIN_CLAIMED_SITES = 200
MAP_SIDE_M, MAP_POSTING_M = 40.0, 0.2
ROW_STRIDE = 4  # every fourth row of the map is evaluated; neighbouring sites are nearly equal
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
# Keys that are not keys of a scenario: distance of the sensor from the map centre, its angle off
# nadir, the number of detector rows and of columns, and whether the relief has craters.
RANGE, ANGLE, PIXELS, RELIEF = "scan.range_m", "scan.angle_deg", "scan.pixels", "relief"
# Per m^2, of craters of 1 m or more, as on maria. Rocks cluster only around craters that age.
CRATERS = {"terrain.crater_density": 0.079, "terrain.crater_degradation": "diffusion"}
MIN_BLOCK_CRATER_M = 5.0  # few craters of the small terrain are wider
# Approach speed along the line of sight, m/s, per square root of the distance, m^0.5: half of what
# a deceleration of 0.8 m/s^2 stops in this distance.
SPEED_PER_ROOT_M = 0.6

BASE: dict[str, Any] = {
    "terrain": {"kind": "fractal", "size_m": 100.0, "posting_m": 0.25},
    "sensors": {
        "imu": {"kind": "imu"}, "altimeter": {"kind": "radar-altimeter"},
        "velocimeter": {"kind": "velocimeter"}, "stars": {"kind": "star-tracker"},
        "flash": {"kind": "flash-lidar", "divergence_mrad": 0.0},
    },
    "tasking": {"flash": {"kind": "at-altitudes", "altitudes_m": [250.0]}},
    "mappers": {
        "dem": {"kind": "gaussian-dem", "size_m": MAP_SIDE_M, "posting_m": MAP_POSTING_M},
    },
}  # fmt: skip

# Ranges that a scenario accepts and that a mission could have. Relief: from a smooth plain to
# highland (Rosenburg et al. 2011). Rocks: cover up to a rocky site (Golombek k = 0.1), heights,
# burial and outlines as far as impact fragments vary (Demidov and Basilevsky 2014; Michikami et al.
# 2016). Lander: from a small one to the lunar module. Sensor: detectors and noise around those of
# the Gaussian DEM paper. Nominal: the defaults of a scenario, seen from 250 m straight above.
SPACE = SearchSpace({
    RELIEF: ChoiceRange(("smooth", "cratered"), "smooth"),
    "terrain.rms_slope_deg": ContinuousRange(0.3, 8.0, 2.5, is_logarithmic=True),
    "terrain.hurst": ContinuousRange(0.6, 0.95, 0.85),
    "rocks.shape": ChoiceRange(
        ("hemisphere", "ellipsoid", "cube", "irregular", "mixed"), "hemisphere"
    ),
    "rocks.height_ratio.0": ContinuousRange(0.3, 0.9, 0.5),
    "rocks.burial.1": ContinuousRange(0.0, 0.6, 0.5),
    "rocks.axis_ratio.0": ContinuousRange(0.4, 1.0, 0.6),
    "rocks.cover": ContinuousRange(0.002, 0.1, 0.05, is_logarithmic=True),
    "rocks.min_diameter_m": ContinuousRange(0.1, 0.25, 0.15, is_logarithmic=True),
    "rocks.max_diameter_m": ContinuousRange(0.3, 3.0, 3.0, is_logarithmic=True),
    "rocks.cluster_fraction": ContinuousRange(0.0, 0.5, 0.0),
    "vehicle.legs": ChoiceRange((3, 4), 4),
    "vehicle.leg_radius_m": ContinuousRange(1.0, 4.2, 2.35),
    "vehicle.roughness_limit_m": ContinuousRange(0.15, 0.5, 0.25),
    "vehicle.slope_limit_deg": ContinuousRange(6.0, 15.0, 10.0),
    PIXELS: ChoiceRange((128, 192, 256, 384), 256),
    "sensors.flash.half_fov_tangent": ContinuousRange(0.05, 0.2, 0.1, is_logarithmic=True),
    "sensors.flash.noise_ratio": ContinuousRange(1e-5, 1e-4, 3.333e-5, is_logarithmic=True),
    RANGE: ContinuousRange(80.0, 500.0, 250.0, is_logarithmic=True),
    ANGLE: ContinuousRange(0.0, 60.0, 0.0),
})  # fmt: skip


def scenario_of(values: Mapping[str, Any]) -> Scenario:
    """Return the scenario of a set of values.

    Its flight starts on the line of sight of the scan, 10 % farther away, and scans from there. Its
    belly clearance equals its roughness limit, because `p_safe` tests the clearance by this limit.
    Rocks form clusters only on cratered relief.
    """
    own = {key: value for key, value in values.items() if key not in (RANGE, ANGLE, PIXELS, RELIEF)}
    distance, angle = values[RANGE], math.radians(values[ANGLE])
    line = np.array([-math.sin(angle), 0.0, math.cos(angle)])
    cratered = values[RELIEF] == "cratered"
    speed = SPEED_PER_ROOT_M * math.sqrt(distance)
    own |= {
        "vehicle.belly_clearance_m": values["vehicle.roughness_limit_m"],
        "sensors.flash.rows": values[PIXELS],
        "sensors.flash.cols": values[PIXELS],
        "start.position_m": [round(float(v), 1) for v in 1.1 * distance * line],
        "start.velocity_m_s": [round(float(v), 1) for v in -speed * line],
        "tasking.flash.altitudes_m": [round(distance * math.cos(angle), 1)],
    }
    if cratered:
        own |= {**CRATERS, "rocks.min_block_crater_diameter_m": MIN_BLOCK_CRATER_M}
    else:
        own["rocks.cluster_fraction"] = 0.0
    changes = [f"{key}={value}" for key, value in own.items()]
    return _with_correct_expectation(with_changes(Scenario.from_dict(BASE), changes))


def _with_correct_expectation(scenario: Scenario) -> Scenario:
    """Return a scenario whose mission expects the rocks that the terrain has."""
    r = scenario.rocks
    law = {
        "shape": r.shape, "height_ratio": list(r.height_ratio), "burial": list(r.burial),
        "axis_ratio": list(r.axis_ratio), "cover": r.cover,
    }  # fmt: skip
    return scenario.changed(expected_rocks=law)


def map_world(
    scenario: Scenario, distance: float, angle_deg: float, seed: int, number: int
) -> tuple[Terrain, HazardMap]:
    """Return the terrain of a world, and its map of one static scan.

    The arguments are those of `map_precision`.

    Raises
    ------
    InputError
        If the rocks do not fit on the terrain.
    """
    sequence = flight_seed(seed, number)
    streams = RandomStreams(sequence)
    relief_seed = int(sequence.generate_state(1)[0])
    scenario = scenario.changed(terrain={"relief_seed": relief_seed})
    terrain = scenario.terrain.make().build(scenario.rocks.make(), streams)
    scan, position = simulate_scan(scenario, terrain, distance, angle_deg, streams)
    pool = SamplePool(Grid.centred((0.0, 0.0), MAP_SIDE_M, MAP_POSTING_M))
    pool.add(scan.points(position, UPRIGHT), scan.height_sigma(UPRIGHT), scan.spacing(UPRIGHT))
    found = DemSnapshot(
        pooled_dem(pool), scenario.vehicle.make(), scenario.expected_rocks.make()
    ).hazard_map
    return terrain, found


def map_precision(
    scenario: Scenario, distance: float, angle_deg: float, seed: int, number: int
) -> dict[str, Any]:
    """Return the precision of the claims of a map of one static scan.

    Parameters
    ----------
    scenario
        Scenario with a LiDAR `flash`. Its relief seed is replaced.
    distance, angle_deg
        Distance of the sensor from the map centre, m, and its angle off nadir, deg.
    seed, number
        Root seed and number of the draw of relief, rocks, azimuth and noise.

    Returns
    -------
    dict
        Number of `claimed` sites and of `unsafe` ones among them; `precision`, NaN without claims;
        processor time `cpu_s`.

    Raises
    ------
    InputError
        If the rocks do not fit on the terrain.
    """
    start = time.process_time()
    terrain, drawn = map_world(scenario, distance, angle_deg, seed, number)
    lander = scenario.vehicle.make()
    claimed = claimed_sites(drawn)
    safe = site_safety(terrain, drawn.grid, lander, where=claimed)[0][claimed]
    return {
        "claimed": len(safe), "unsafe": int((~safe).sum()),
        "precision": float(safe.mean()) if len(safe) else math.nan,
        "cpu_s": time.process_time() - start,
    }  # fmt: skip


def simulate_scan(
    scenario: Scenario, terrain: Terrain, distance: float, angle_deg: float, streams: RandomStreams
) -> tuple[LidarScan, np.ndarray]:
    """Simulate one scan of the map centre; return it and the true sensor position (3,), m."""
    angle, azimuth = np.deg2rad(angle_deg), streams.get("azimuth").uniform(0.0, 2.0 * np.pi)
    centre = np.array([0.0, 0.0, float(terrain.elevation(np.zeros(2)))])
    away = np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth),
                     np.cos(angle)])  # fmt: skip
    position = centre + distance * away
    state = State(position, np.zeros(3), UPRIGHT, np.zeros(3), 1.0)
    world = World(terrain, scenario.gravity_m_s2)
    lidar = scenario.sensors["flash"].make()
    scan = lidar.measure(world, state, 0.0, streams.get("flash"), sensor_axes(centre - position))
    return scan, position


def claimed_sites(drawn: HazardMap) -> np.ndarray:
    """Return which cells of every fourth row of a map are claimed as safe (rows, cols)."""
    is_claimed = drawn.observed & drawn.in_domain & (drawn.p_safe > CLAIMED_P)
    is_claimed[np.arange(drawn.grid.rows) % ROW_STRIDE != 0] = False
    return np.asarray(is_claimed)


def measure(case: Case) -> dict[str, Any]:
    """Measure the map of one world; the score is the precision of its claims.

    Without enough claims, the score is 1 plus the missing fraction. If the rocks do not fit on the
    terrain, it is infinite.
    """
    values = case["values"]
    scenario = scenario_of(values)
    try:
        row = map_precision(scenario, values[RANGE], values[ANGLE], case.seed, case.number)
    except InputError as error:
        return {"score": math.inf, "rejected": str(error)}
    missing = 1.0 - row["claimed"] / MIN_CLAIMED_SITES
    return {"score": 1.0 + missing if missing > 0.0 else row["precision"], **row}


PROBLEM = WorstCaseProblem(
    SPACE, scenario_of, CLAIMED_P, f"precision of the claims with p_safe > {CLAIMED_P}"
)

study = Study(
    measure,
    repeats="evaluations",
    count=200,
    minimum=30,
    options=OPTIONS,
    metrics={
        "claimed": Metric("claimed sites, median", "median", 0),
        "unsafe": Metric("unsafe of them, median", "median", 0),
        "cpu_s": Metric("processor time (s), median", "median", 2),
    },
    explore=PROBLEM.explore,
    report=PROBLEM.report,
)

if __name__ == "__main__":
    run_script(study)
