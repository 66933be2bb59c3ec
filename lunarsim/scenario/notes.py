"""What is odd about a scenario that can be flown: figures that disagree, keys without effect."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from lunarsim.messages.measurements import Picture
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.mapper import sensors_of
from lunarsim.parts import PartSettings, kinds
from lunarsim.scenario.scenario import Scenario

# Kinds of sensors that see the Sun or what it lights.
_SEE_LIGHT = ("camera", "star-tracker")
# Mass of a lander lies, on the root mean square, between these shares of the circle of its legs off
# an axis: a ball of the same size has 0.63, a ring 1.
_LEAST_GYRATION, _MOST_GYRATION = 0.1, 0.75
# Slower than this in turning, or faster, torques were made for another lander, rad/s^2.
_SLOW, _FAST = 0.01, 20.0
# Roughness of the ground between the posts of a raster.
_ROUGHNESS = (
    "preset", "hurst", "rms_slope_deg", "crater_density", "crater_saturation_m",
    "crater_min_diameter_m", "crater_ageing",
)  # fmt: skip
_CRATERS = ("crater_saturation_m", "crater_min_diameter_m", "crater_ageing")


def notes_on(scenario: Scenario) -> list[str]:
    """Return a sentence for each thing that is odd, with field, value and remedy.

    Parameters
    ----------
    scenario
        Checked; nothing here keeps it from being flown.
    """
    lander = scenario.vehicle.make()
    figures = list(_lander_notes(lander)) if isinstance(lander, Lander) else []
    return [*figures, *_without_effect(scenario), *_sensor_notes(scenario), *_variation(scenario)]


# --- a lander whose figures disagree ------------------------------------------------------------


def _lander_notes(lander: Lander) -> Iterator[str]:
    yield from _gyration_notes(lander)
    dry, full = np.asarray(lander.inertia_dry), np.asarray(lander.inertia_full)
    if (full < dry).any():
        yield (
            f"vehicle.inertia_full_kg_m2 = {_listed(full)}: less than inertia_dry_kg_m2 = "
            f"{_listed(dry)}, with {lander.propellant_mass:g} kg of propellant more on board"
        )
    turn = np.asarray(lander.torque_max) / full
    if turn.min() < _SLOW or turn.max() > _FAST:
        yield (
            f"vehicle.torque_max_n_m = {_listed(lander.torque_max)}: turns this lander at "
            f"{turn.min():.3g} to {turn.max():.3g} rad/s^2, usual are {_SLOW:g} to {_FAST:g}: "
            "does it go with inertia_full_kg_m2?"
        )
    yield from _standing_notes(lander)


def _gyration_notes(lander: Lander) -> Iterator[str]:
    """Yield what masses and moments say of where the mass would lie."""
    for name, mass in (("dry", lander.dry_mass), ("full", lander.wet_mass)):
        moments = np.asarray(getattr(lander, f"inertia_{name}"))
        radius = np.sqrt(moments / mass)
        least = _LEAST_GYRATION * lander.leg_radius
        most = _MOST_GYRATION * lander.leg_radius
        if radius.min() < least or radius.max() > most:
            yield (
                f"vehicle.inertia_{name}_kg_m2 = {_listed(moments)}: puts the mass of {mass:g} kg "
                f"{radius.min():.2g} to {radius.max():.2g} m off the axes, a lander on legs of "
                f"{lander.leg_radius:g} m has {least:.2g} to {most:.2g} m; left out, it follows "
                "the mass"
            )
            return


def _standing_notes(lander: Lander) -> Iterator[str]:
    """Yield what geometry and landing tolerances say of each other."""
    stands = math.degrees(
        math.atan(lander.leg_radius * math.cos(math.pi / lander.legs) / lander.com_height)
    )
    slope = math.degrees(lander.slope_limit)
    if stands < slope:
        yield (
            f"vehicle.slope_limit_deg = {slope:.3g}: on {lander.legs} legs of "
            f"{lander.leg_radius:g} m with its mass {lander.com_height:g} m up it tips over from "
            f"{stands:.3g} deg on"
        )
    if lander.belly_clearance < lander.roughness_limit:
        yield (
            f"vehicle.roughness_limit_m = {lander.roughness_limit:g}: the belly touches from "
            f"belly_clearance_m = {lander.belly_clearance:g} m on"
        )


def _listed(values: Any) -> str:
    return "[" + ", ".join(f"{float(v):.6g}" for v in values) + "]"


# --- sensors and commands ------------------------------------------------------------------------


def _sensor_notes(scenario: Scenario) -> Iterator[str]:
    """Yield what sensors measure in vain."""
    mapped = {name for part in scenario.mappers.values() for name in sensors_of(part.make())}
    for name, settings in scenario.sensors.items():
        sensor = settings.make()
        looks = getattr(scenario.tasking[name].make(), "looks", None) if sensor.tasked else None
        reach = getattr(sensor, "max_range", None)
        if looks is not None and reach is not None:
            lowest = min(looks.at) if looks.at else looks.lowest
            if lowest >= reach:
                yield (
                    f"sensors.{name}.max_range_m = {reach:g}: without a return, [tasking.{name}] "
                    f"measures from {lowest:g} m up. Raise max_range_m or lower the altitudes"
                )
        if issubclass(sensor.gives, Picture) and name not in mapped:
            yield (
                f"sensors.{name} = {settings.kind!r}: no mapper uses its images; the record holds "
                "when it took them"
            )


def _variation(scenario: Scenario) -> Iterator[str]:
    """Yield which commands use a table that flights refuse."""
    if scenario.variation is not None:
        yield (
            "variation = given: `fly`, `compare` and campaigns refuse it. It is for the "
            "environments: `lunarsim evaluate Guidance-v0 --scenario FILE --agent apollo`"
        )


# --- settings without effect --------------------------------------------------------------------


def _without_effect(scenario: Scenario) -> Iterator[str]:
    lit = [p.kind for p in scenario.sensors.values() if _sees_light(p.kind)]
    if not lit:
        yield from _idle("sun", scenario.sun, "no sensor of kind 'camera' or 'star-tracker' flies")
    if scenario.terrain.kind == "hazard-field":
        yield from _idle("rocks", scenario.rocks, "the boulders of a 'hazard-field' are its own")
    elif scenario.rocks.cover == 0.0:
        yield from _idle("rocks", scenario.rocks, "there are none with cover = 0", but=("cover",))
    elif scenario.rocks.clustered == 0.0:
        yield from _idle(
            "rocks", scenario.rocks, "none lie about craters with clustered = 0",
            only=("block_crater_m",),
        )  # fmt: skip
    yield from _idle_ground(scenario)
    if scenario.policy.kind == "no-divert":
        yield from _idle(
            "decisions", scenario.decisions, "policy 'no-divert' decides nothing", but=("map",)
        )
    if not scenario.mappers:
        yield from _idle("expected_rocks", scenario.expected_rocks, "no mapper reads it")


def _idle_ground(scenario: Scenario) -> Iterator[str]:
    ground = scenario.terrain
    if ground.kind == "dtm" and not ground.detail:
        yield from _idle(
            "terrain", ground.table, "nothing is added between the posts with detail = false",
            only=_ROUGHNESS,
        )  # fmt: skip
    elif ground.kind in ("fractal", "dtm"):
        density = ground.crater_density
        if density == 0.0 or (density is None and ground.preset == "none"):
            yield from _idle("terrain", ground.table, "there are no craters", only=_CRATERS)


def _sees_light(kind: str) -> bool:
    """Tell whether the Sun may matter to a sensor; of others than the package's that is so."""
    return kind in _SEE_LIGHT or kind not in kinds("sensor")


def _idle(
    table: str,
    settings: PartSettings,
    why: str,
    *,
    only: tuple[str, ...] | None = None,
    but: tuple[str, ...] = (),
) -> Iterator[str]:
    """Yield a sentence that names the keys of a table that were set and do nothing."""
    fields = type(settings).model_fields
    values: Mapping[str, Any] = {key: getattr(settings, key) for key in fields}
    found = [
        f"{table}.{key} = {_word(value)}"
        for key, value in values.items()
        if key not in but and (only is None or key in only) and value != fields[key].default
    ]
    if found:
        yield f"{', '.join(found)}: without effect, {why}"


def _word(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_word(v) for v in value) + "]"
    return f"{value:g}" if isinstance(value, float) else repr(value)
