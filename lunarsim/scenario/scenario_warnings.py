"""Warn about inconsistent values and keys without effect in a scenario."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from lunarsim.messages.measurements import CameraImage
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.rotation import tilt_torque
from lunarsim.onboard.hazards.mapper import sensor_names
from lunarsim.parts import PartSettings, kinds
from lunarsim.scenario.scenario import Scenario
from lunarsim.scenario.site_values import sun_values
from lunarsim.vehicle.true_vehicle import VehicleDeviations

# Plausible radius of gyration over the radius of the leg circle. A solid sphere has 0.63, a thin
# ring 1.
_MIN_GYRATION_RATIO, _MAX_GYRATION_RATIO = 0.1, 0.75
# Plausible angular acceleration at full torque, rad/s^2.
_SLOW, _FAST = 0.01, 20.0
# Keys of the terrain detail that is added between the posts of a raster.
_ROUGHNESS = (
    "preset", "hurst", "rms_slope_deg", "crater_density", "crater_equilibrium_diameter_m",
    "crater_min_diameter_m", "crater_degradation",
)  # fmt: skip
_CRATERS = ("crater_equilibrium_diameter_m", "crater_min_diameter_m", "crater_degradation")


def warnings_for(scenario: Scenario) -> list[str]:
    """Return warnings about inconsistent or unused values of a scenario.

    Parameters
    ----------
    scenario
        A valid scenario. Warnings do not prevent a flight.

    Returns
    -------
    list of str
        Sentences that name scenario key and value.
    """
    lander = scenario.vehicle.make()
    figures = list(_lander_warnings(lander)) if isinstance(lander, Lander) else []
    return [
        *figures,
        *_true_lander_warnings(scenario),
        *_unused_key_warnings(scenario),
        *_sensor_warnings(scenario),
        *_randomization_warnings(scenario),
    ]


# --- inconsistent lander parameters -------------------------------------------------------------


def _true_lander_warnings(scenario: Scenario) -> Iterator[str]:
    """Yield warnings if the true lander cannot hover, sink or balance its engine."""
    if scenario.truth.make().vehicle == VehicleDeviations():
        return
    lander, nominal = scenario.true_lander(), scenario.vehicle.make()
    thrust = lander.thrust_scale * lander.thrust_max
    weight = lander.wet_mass * scenario.gravity_m_s2
    if thrust <= weight:
        yield (
            f"truth.vehicle: the maximum thrust of the true lander is {thrust:.0f} N, less than "
            f"its weight of {weight:.0f} N, got thrust_scale = {lander.thrust_scale:g}."
        )
    thrust_min = lander.thrust_scale * lander.thrust_min
    dry_weight = lander.dry_mass * scenario.gravity_m_s2
    if thrust_min >= dry_weight and nominal.thrust_min < nominal.dry_mass * scenario.gravity_m_s2:
        yield (
            f"truth.vehicle: the minimum thrust of the true lander is {thrust_min:.0f} N, more "
            f"than its weight of {dry_weight:.0f} N without propellant: it may climb before "
            f"touchdown, got thrust_scale = {lander.thrust_scale:g}."
        )
    if isinstance(lander, JetLander):
        angle = max(float(np.abs(lander.thrust_misalignment).max()) - lander.engine.gimbal_limit, 0)
        arm = lander.engine.pivot_depth + min(lander.com_dry[2], lander.com_full[2])
        torque, able = weight * arm * np.sin(angle), float(tilt_torque(lander))
        if torque >= able:
            yield (
                f"truth.vehicle: the misaligned thrust turns the hovering lander with "
                f"{torque:.0f} N m, more than the {able:.0f} N m of its thrusters, got "
                f"thrust_misalignment_deg = {_listed(np.rad2deg(lander.thrust_misalignment))}."
            )


def _lander_warnings(lander: Lander) -> Iterator[str]:
    yield from _gyration_warnings(lander)
    dry, full = np.asarray(lander.inertia_dry), np.asarray(lander.inertia_full)
    if (full < dry).any():
        yield (
            f"vehicle.inertia_full_kg_m2: is less than inertia_dry_kg_m2 = {_listed(dry)} in spite "
            f"of {lander.propellant_mass:g} kg of propellant, got {_listed(full)}."
        )
    turn = np.asarray(lander.torque_max) / full
    if turn.min() < _SLOW or turn.max() > _FAST:
        yield (
            f"vehicle.torque_max_n_m: gives {turn.min():.3g} to {turn.max():.3g} rad/s^2 (usual: "
            f"{_SLOW:g} to {_FAST:g}), got {_listed(lander.torque_max)}. Check it against "
            "inertia_full_kg_m2."
        )
    yield from _geometry_warnings(lander)


def _gyration_warnings(lander: Lander) -> Iterator[str]:
    """Yield a warning if the moments of inertia are implausible for the lander's size.

    The radii of gyration, without and with propellant, must be 0.1 to 0.75 leg radii. At most one
    warning is given.
    """
    for name, mass in (("dry", lander.dry_mass), ("full", lander.wet_mass)):
        moments = np.asarray(getattr(lander, f"inertia_{name}"))
        radius = np.sqrt(moments / mass)
        least = _MIN_GYRATION_RATIO * lander.leg_radius
        most = _MAX_GYRATION_RATIO * lander.leg_radius
        if radius.min() < least or radius.max() > most:
            yield (
                f"vehicle.inertia_{name}_kg_m2: radii of gyration are {radius.min():.2g} to "
                f"{radius.max():.2g} m for {mass:g} kg (usual for legs at {lander.leg_radius:g} m: "
                f"{least:.2g} to {most:.2g} m), got {_listed(moments)}. Omit it to derive it from "
                "the mass."
            )
            return


def _geometry_warnings(lander: Lander) -> Iterator[str]:
    """Yield warnings about slope and roughness limits that the legs do not allow."""
    stands = math.degrees(
        math.atan(lander.leg_radius * math.cos(math.pi / lander.legs) / lander.com_height)
    )
    slope = math.degrees(lander.slope_limit)
    if stands < slope:
        yield (
            f"vehicle.slope_limit_deg: the lander tips over at {stands:.3g} deg (legs: "
            f"{lander.legs} at {lander.leg_radius:g} m, centre of mass {lander.com_height:g} m "
            f"high), got {slope:.3g}."
        )
    if lander.belly_clearance < lander.roughness_limit:
        yield (
            f"vehicle.roughness_limit_m: exceeds belly_clearance_m = {lander.belly_clearance:g}, "
            f"got {lander.roughness_limit:g}."
        )


def _listed(values: Any) -> str:
    return "[" + ", ".join(f"{float(v):.6g}" for v in values) + "]"


# --- sensors and commands ------------------------------------------------------------------------


def _sensor_warnings(scenario: Scenario) -> Iterator[str]:
    """Yield warnings about ranges beyond a sensor's limit and about unused cameras.

    A sensor gets a warning if all altitudes of its measurements are above its maximum range, and a
    camera if no mapper uses its images.
    """
    mapped = {name for part in scenario.mappers.values() for name in sensor_names(part.make())}
    keeps_images = scenario.record is not None and scenario.record.make().images
    for name, settings in scenario.sensors.items():
        sensor = settings.make()
        looks = (
            getattr(scenario.tasking[name].make(), "measurement_altitudes", None)
            if sensor.is_tasked
            else None
        )
        reach = getattr(sensor, "max_range", None)
        if looks is not None and reach is not None:
            lowest = min(looks.at) if looks.at else looks.lowest
            if lowest >= reach:
                yield (
                    f"sensors.{name}.max_range_m: is too short for any LiDAR return, because "
                    f"[tasking.{name}] measures above {lowest:g} m only, got {reach:g}. Raise "
                    "max_range_m or lower the altitudes."
                )
        is_camera = issubclass(sensor.measurement_type, CameraImage)
        if is_camera and name not in mapped and not keeps_images:
            yield (
                f"sensors.{name}: no mapper uses its images, got {settings.kind!r}. The flight "
                "record contains their times only; it keeps the images if record.images = true."
            )


def _randomization_warnings(scenario: Scenario) -> Iterator[str]:
    """Yield a warning if a scenario has the table domain_randomization.

    Only environments use this table.
    """
    if scenario.domain_randomization is not None:
        yield (
            "domain_randomization: only environments accept this table; `fly`, `compare` and "
            "campaigns refuse "
            "it. Use `lunarsim evaluate Guidance-v1 --scenario FILE --agent apollo`."
        )


# --- settings without effect --------------------------------------------------------------------


def _unused_key_warnings(scenario: Scenario) -> Iterator[str]:
    if not any(_may_need_sunlight(p.kind, p.make()) for p in scenario.sensors.values()):
        given = () if scenario.site is None else tuple(sun_values(scenario.site.make()))
        yield from _unused_keys("sun", scenario.sun, "no sensor depends on sunlight", ignored=given)
    if scenario.terrain.kind == "hazard-field":
        yield from _unused_keys(
            "rocks", scenario.rocks, "terrain 'hazard-field' has its own boulders"
        )
    elif scenario.rocks.cover == 0.0:
        yield from _unused_keys(
            "rocks", scenario.rocks, "cover = 0 means no rocks", ignored=("cover",)
        )
    elif scenario.rocks.cluster_fraction == 0.0:
        yield from _unused_keys(
            "rocks", scenario.rocks, "cluster_fraction = 0 means no rocks around craters",
            only=("min_block_crater_diameter_m",),
        )  # fmt: skip
    yield from _unused_terrain_keys(scenario)
    for name, part in scenario.sensor_faults.items():
        for key in ("size", "rate", "sigma"):
            if getattr(part.table, key, None) == 0.0:
                yield f"sensor_faults.{name}.{key} = 0: no effect, because the fault has no size."
    if scenario.policy.kind == "no-divert":
        yield from _unused_keys(
            "decisions", scenario.decisions, "policy 'no-divert' never diverts", ignored=("map",)
        )
    sensors = [part.make() for part in scenario.sensors.values()]
    if scenario.record is not None and not any(
        issubclass(sensor.measurement_type, CameraImage) for sensor in sensors
    ):
        yield from _unused_keys(
            "record", scenario.record, "no sensor is a camera", only=("images",)
        )
    if not scenario.mappers:
        yield from _unused_keys("expected_rocks", scenario.expected_rocks, "there is no mapper")


def _unused_terrain_keys(scenario: Scenario) -> Iterator[str]:
    terrain = scenario.terrain
    if terrain.kind == "dtm" and not terrain.detail:
        yield from _unused_keys(
            "terrain", terrain.table, "detail = false adds nothing between the posts",
            only=_ROUGHNESS,
        )  # fmt: skip
    elif terrain.kind in ("fractal", "dtm"):
        density = terrain.crater_density
        if density == 0.0 or (density is None and terrain.preset == "none"):
            yield from _unused_keys(
                "terrain", terrain.table, "the terrain has no craters", only=_CRATERS
            )


def _may_need_sunlight(kind: str, sensor: Any) -> bool:
    """Return whether a sensor may depend on sunlight.

    It is what `needs_sunlight` states; without it, true for custom kinds only.
    """
    return bool(getattr(sensor, "needs_sunlight", kind not in kinds("sensor")))


def _unused_keys(
    table: str,
    settings: PartSettings,
    reason: str,
    *,
    only: tuple[str, ...] | None = None,
    ignored: tuple[str, ...] = (),
) -> Iterator[str]:
    """Yield a warning that names all keys of a table that differ from their defaults.

    The caller has found that these keys have no effect; `reason` states why, at the end of the
    warning. Keys are included if in `only` (None: all) and not in `ignored`. Without such a key
    nothing is yielded.
    """
    fields = type(settings).model_fields
    values: Mapping[str, Any] = {key: getattr(settings, key) for key in fields}
    found = [
        f"{table}.{key} = {_word(value)}"
        for key, value in values.items()
        if key not in ignored and (only is None or key in only) and value != fields[key].default
    ]
    if found:
        yield f"{', '.join(found)}: no effect, because {reason}."


def _word(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_word(v) for v in value) + "]"
    return f"{value:g}" if isinstance(value, float) else repr(value)
