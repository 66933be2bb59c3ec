"""Check that the components of a scenario fit together and have an effect."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from lunarsim.errors import InputError, suggestion
from lunarsim.messages.measurements import CameraImage, InertialSamples, LidarScan, NavigationFix
from lunarsim.models.jet_lander import JetLander
from lunarsim.onboard.hazards.fusion import FusedMapperSettings
from lunarsim.onboard.hazards.mapper import check_map_size, sensor_names
from lunarsim.onboard.hazards.shadows.mapping import ShadowMapping
from lunarsim.onboard.perception.shadow_model import MAX_SUN_ELEVATION, MIN_SUN_ELEVATION
from lunarsim.parts import loadable_parts
from lunarsim.sensors.faults import channels_of


class PartTable(Protocol):
    """Scenario table whose key `kind` selects a component, such as a sensor."""

    @property
    def kind(self) -> str:
        """Kind of the component: a registered name or "module:Class"."""
        ...

    @property
    def table(self) -> Any:
        """Values of the keys other than `kind`."""
        ...

    def make(self) -> Any:
        """Create the component that the table describes, in SI units and radians."""
        ...


class CheckedTables(Protocol):
    """Tables of a scenario that the consistency checks read."""

    @property
    def sensors(self) -> Mapping[str, PartTable]:
        """Tables of the sensors, by sensor name."""
        ...

    @property
    def sensor_faults(self) -> Mapping[str, PartTable]:
        """Tables of the sensor faults, by fault name."""
        ...

    @property
    def tasking(self) -> Mapping[str, PartTable]:
        """Tables of the measurement schedules, by name of the sensor that they command."""
        ...

    @property
    def mappers(self) -> Mapping[str, PartTable]:
        """Tables of the hazard mappers, by mapper name."""
        ...

    @property
    def navigation(self) -> PartTable:
        """Table of the navigation filter."""
        ...

    @property
    def control(self) -> PartTable:
        """Table of the attitude control."""
        ...

    @property
    def decisions(self) -> Any:
        """Table of the divert decisions."""
        ...

    @property
    def simulation(self) -> Any:
        """Table of the simulation's time step and control cycle."""
        ...

    @property
    def far_terrain(self) -> Any:
        """Table of the terrain around the landing area, or None."""
        ...

    @property
    def moon(self) -> Any:
        """Table of the Moon as a rotating sphere with central gravity, or None."""
        ...

    @property
    def prior_map(self) -> Any:
        """Table of the terrain map that navigation has before the flight, or None."""
        ...

    @property
    def initial_uncertainty(self) -> Any:
        """Table of the initial uncertainty of the state estimate, or None."""
        ...

    @property
    def vehicle(self) -> PartTable:
        """Table of the lander."""
        ...

    def true_lander(self) -> Any:
        """Create the true lander, with the deviations of `[truth.vehicle]`."""
        ...

    @property
    def sun(self) -> Any:
        """Table of the illumination by the Sun."""
        ...

    @property
    def faults(self) -> Any:
        """Table of the actuator faults, or None."""
        ...


def check(scenario: CheckedTables) -> None:
    """Check that a scenario's components fit together and that each of them is used.

    Raises
    ------
    InputError
        If a check fails; the error names the first invalid field.
    """
    for table in ("sensors", "sensor_faults", "tasking", "mappers"):
        _check_names(table, getattr(scenario, table))
    sensors = {name: part.make() for name, part in scenario.sensors.items()}
    _check_unique_sensors(sensors)
    _check_sensor_faults(scenario, sensors)
    _check_filter_states(scenario)
    _check_mappers(scenario, sensors)
    _check_navigation(scenario, sensors)
    _check_control(scenario, sensors)
    _check_actuators(scenario)
    _check_tasking(scenario, sensors)
    _check_all_used(scenario, sensors)
    chosen = scenario.decisions.map
    if chosen and chosen not in scenario.mappers:
        raise InputError(
            "decisions.map", chosen, "must be the name of a mapper",
            suggestion(chosen, scenario.mappers),
        )  # fmt: skip


def _check_names(table: str, parts: Mapping[str, PartTable]) -> None:
    """Check that the names of tables are valid names of files and columns.

    `table` is the group of the named tables, for example sensors.
    """
    for name in parts:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", name):
            raise InputError(
                table,
                name,
                "must have names that start with a letter and consist of letters, digits, _ and -",
            )


def _check_unique_sensors(sensors: dict[str, Any]) -> None:
    """Check that the scenario has at most one IMU and one navigation-fix sensor."""
    words = {InertialSamples: "inertial measurement unit", NavigationFix: "navigation-fix sensor"}
    for only, noun in words.items():
        names = [
            name for name, sensor in sensors.items() if issubclass(sensor.measurement_type, only)
        ]
        if len(names) > 1:
            raise InputError(
                f"sensors.{names[1]}", names, f"must not be a second {noun}",
                f"Keep only one of these sensors: {', '.join(names)}.", show_value=False,
            )  # fmt: skip


def _check_sensor_faults(scenario: CheckedTables, sensors: dict[str, Any]) -> None:
    """Check that each sensor fault names a sensor that can have it."""
    for name, part in scenario.sensor_faults.items():
        fault, field = part.make(), f"sensor_faults.{name}"
        if fault.sensor not in sensors:
            raise InputError(
                f"{field}.sensor", fault.sensor, "must be the name of a sensor",
                suggestion(fault.sensor, sensors),
            )  # fmt: skip
        measured, kind = sensors[fault.sensor].measurement_type, scenario.sensors[fault.sensor].kind
        if not fault.applies_to(measured):
            possible = [k for k, f in loadable_parts("sensor-fault") if f.applies_to(measured)]
            raise InputError(
                f"{field}.kind", part.kind, f"is not possible for a sensor of kind {kind!r}",
                f"Kinds for this sensor: {', '.join(possible)}.",
            )  # fmt: skip
        channel, known = getattr(fault, "channel", ""), channels_of(measured)
        if channel and channel not in known:
            raise InputError(
                f"{field}.channel", channel,
                f"must be a quantity that a sensor of kind {kind!r} measures",
                f"Quantities: {', '.join(known)}.",
            )  # fmt: skip


def _check_filter_states(scenario: CheckedTables) -> None:
    """Check that at most one mapper adds states to the navigation filter."""
    names = [
        name
        for name, part in scenario.mappers.items()
        if getattr(part.make(), "navigation", None) is not None
    ]
    if len(names) > 1:
        raise InputError(
            f"mappers.{names[1]}", names,
            "must not be a second mapper that adds states to the navigation filter",
            f"Keep only one of these mappers: {', '.join(names)}.", show_value=False,
        )  # fmt: skip


def _has_sensor_for(sensors: dict[str, Any], measurement_type: type) -> bool:
    """Return whether any sensor outputs measurements of a type."""
    types = (sensor.measurement_type for sensor in sensors.values())
    return any(issubclass(one, measurement_type) for one in types)


def _sensor_kinds_for(measurement_type: type) -> str:
    """Return a phrase that names the sensors of a measurement type.

    It lists the registered kinds, such as "of kind 'imu'", or the type if there are none.
    """
    found = [
        repr(kind)
        for kind, sensor in loadable_parts("sensor")
        if isinstance(sensor.measurement_type, type)
        and issubclass(sensor.measurement_type, measurement_type)
    ]
    names = " or ".join(found)
    return f"of kind {names}" if names else f"with measurement type {measurement_type.__name__}"


def _kinds_of(contract: str, base: type) -> str:
    """Return the kinds of a contract whose class derives from `base`, joined by "or".

    If there are none, return the name of `base` as "module:Class".
    """
    found = [repr(kind) for kind, part in loadable_parts(contract) if issubclass(part, base)]
    return " or ".join(found) or f'"{base.__module__}:{base.__qualname__}"'


def _check_mappers(scenario: CheckedTables, sensors: dict[str, Any]) -> None:
    """Check that each hazard mapper has what it needs, and that its map is valid.

    A mapper needs sensors, and some need other mappers, a certain navigation filter, or a range of
    Sun elevations.
    """
    for name, part in scenario.mappers.items():
        mapper = part.make()
        field = f"mappers.{name}"
        if isinstance(mapper, FusedMapperSettings):
            _check_other_mappers(field, mapper.fused_mappers, scenario)
            continue
        if isinstance(mapper, ShadowMapping):
            _check_other_mappers(field, mapper.check_terrain_mapper, scenario)
            _check_sun_elevation(field, scenario.sun.elevation_deg)
        _check_map_size(field, mapper, scenario)
        _check_sensors(field, mapper, scenario.sensors, sensors)
        needed = getattr(mapper, "navigation", None)
        if needed is not None and not isinstance(scenario.navigation.make(), needed):
            raise InputError(
                "navigation.kind", scenario.navigation.kind,
                f"must be {_kinds_of('navigation', needed)}, because {field} (kind {part.kind!r}) "
                "works only with this navigation filter",
            )  # fmt: skip


def _check_sun_elevation(field: str, elevation: float) -> None:
    """Check that the Sun's elevation (deg) is one at which shadows can be mapped.

    `field` is the mapper's table.
    """
    least, most = np.rad2deg([MIN_SUN_ELEVATION, MAX_SUN_ELEVATION])
    if not least - 1e-9 <= elevation <= most + 1e-9:
        raise InputError(
            "sun.elevation_deg", elevation,
            f"must be between {least:.0f} and {most:.0f} degrees, because {field} maps rocks by "
            "their shadows",
        )  # fmt: skip


def _check_sensors(
    field: str, mapper: Any, tables: Mapping[str, PartTable], sensors: dict[str, Any]
) -> None:
    """Check that the sensors of a mapper exist and output what the mapper accepts.

    `field` is the mapper's table. `tables` and `sensors` are the tables and the settings of all
    sensors, by sensor name.
    """
    key = f"{field}.sensors" if getattr(mapper, "sensors", ()) else f"{field}.sensor"
    for name in sensor_names(mapper) or (mapper.sensor,):
        wanted = f"must name a sensor {_sensor_kinds_for(mapper.accepts)}"
        known = ", ".join(f"{one} ({table.kind})" for one, table in tables.items()) or "none"
        if name not in sensors:
            raise InputError(
                key, name, f"{wanted}, but no sensor is named {name!r}",
                f"Sensors and their kinds: {known}.", show_value=False,
            )  # fmt: skip
        if not issubclass(sensors[name].measurement_type, mapper.accepts):
            raise InputError(
                key, name, f"{wanted}, but the sensor {name!r} is of kind {tables[name].kind!r}",
                f"Sensors and their kinds: {known}.", show_value=False,
            )  # fmt: skip


def _check_other_mappers(
    field: str, check: Callable[[dict[str, Any]], Any], scenario: CheckedTables
) -> None:
    """Check that the other mappers that a mapper needs exist and provide its input.

    `field` is the mapper's table. `check` takes the settings of all mappers by name, and raises an
    InputError if one is missing or unsuitable.
    """
    try:
        check({name: part.make() for name, part in scenario.mappers.items()})
    except InputError as error:
        raise error.with_field(f"{field}.{error.field}") from None


def _check_map_size(field: str, mapper: Any, scenario: CheckedTables) -> None:
    """Check that a mapper's map is neither too small, too coarse nor too large.

    The cell side must be at most half the lander's leg radius, the side of the map at least 4 leg
    radii plus 1 m, and the number of cells limited (`check_map_size`). A mapper without `size` and
    `posting` is not checked. `field` is the mapper's table.
    """
    size, posting = getattr(mapper, "size", None), getattr(mapper, "posting", None)
    if isinstance(size, float | int) and isinstance(posting, float | int):
        try:
            check_map_size(size, posting, scenario.vehicle.make())
        except InputError as error:
            raise error.with_field(f"{field}.{error.field}") from None


def _check_navigation(scenario: CheckedTables, sensors: dict[str, Any]) -> None:
    """Check that navigation has the sensors and the prior map that it needs."""
    navigation = scenario.navigation.make()
    for wanted in navigation.needs:
        if not _has_sensor_for(sensors, wanted):
            raise InputError(
                "navigation.kind", scenario.navigation.kind,
                f"{scenario.navigation.kind!r} needs a sensor {_sensor_kinds_for(wanted)}, and the "
                "scenario has none",
                "Add the sensor as a table [sensors.NAME].", show_value=False,
            )  # fmt: skip
    if navigation.needs_prior_map and scenario.prior_map is None:
        raise InputError(
            "prior_map", None,
            f"is required, because navigation of kind {scenario.navigation.kind!r} matches scans "
            "to the prior map",
            "Add a table [prior_map].", show_value=False,
        )  # fmt: skip


def _check_control(scenario: CheckedTables, sensors: dict[str, Any]) -> None:
    """Check that attitude control has an IMU and is stable with the simulation step.

    Control that commands no torques needs no IMU.
    """
    if scenario.control.make().torques and not _has_sensor_for(sensors, InertialSamples):
        raise InputError(
            "control.kind", scenario.control.kind,
            f"{scenario.control.kind!r} needs a sensor of kind 'imu', and the scenario has none",
            "Add a table [sensors.NAME] with kind = \"imu\", or use control.kind = 'ideal'.",
            show_value=False,
        )  # fmt: skip
    step = scenario.simulation.make().step
    frequency = getattr(scenario.control.make(), "frequency", 0.0)
    damping = getattr(scenario.control.make(), "damping", 0.0)
    # Stability of the sampled loop: the rate feedback gain 2 * damping * frequency must be well
    # below 2 / step, and the delay of 1.5 steps must not use up the phase margin.
    if frequency * step > 0.15 or 2.0 * damping * frequency * step > 0.4:
        most = min(0.15 / step, 0.2 / (damping * step) if damping else np.inf)
        raise InputError(
            "control.frequency_rad_s", frequency,
            f"must be at most {most:g} rad/s for a stable attitude loop with control.damping = "
            f"{damping:g} and simulation.step_s = {step:g} s",
        )  # fmt: skip


def _check_actuators(scenario: CheckedTables) -> None:
    """Check that lander, attitude control and actuator faults fit together.

    A lander with attitude thrusters (`JetLander`) needs control that commands torques, with a
    period that the thrusters can follow. Control that commands thrusters needs such a lander.
    Faults must fit the engine and the number of thrusters, and the true lander must be possible.
    """
    lander, control = scenario.vehicle.make(), scenario.control.make()
    jets = isinstance(lander, JetLander)
    field, kind = "control.kind", scenario.control.kind
    if jets and not control.torques:
        raise InputError(
            field, kind,
            f"must be a control that commands torques, because the thrusters turn a vehicle "
            f"of kind {scenario.vehicle.kind!r}", "Use control.kind = 'pd', for instance."
        )  # fmt: skip
    if not jets and hasattr(control, "rate_change"):
        raise InputError(
            field, kind,
            f"{kind!r} commands thrusters and needs a vehicle of kind "
            f"{_kinds_of('vehicle', JetLander)}, but vehicle.kind is {scenario.vehicle.kind!r}",
            "Change the vehicle, or use control.kind = 'pd', for instance.", show_value=False,
        )  # fmt: skip
    scenario.true_lander()
    if scenario.faults is not None:
        faults = scenario.faults.make()
        if jets:
            faults.check_count(lander.thrusters.count)
        else:
            faults.check_plain()
        faults.check_engine(lander.thrust_min, lander.thrust_max)
    if not jets:
        return
    period, step = getattr(control, "period", 0.1), scenario.simulation.make().step
    if abs(period / step - round(period / step)) > 1e-6 or period < step:
        raise InputError(
            "control.period_s",
            period,
            f"must be a multiple of simulation.step_s, which is {step:g} s",
        )
    if lander.thrusters.min_on_time > period:
        raise InputError(
            "vehicle.thrusters.min_on_time_s", lander.thrusters.min_on_time,
            f"must be at most control.period_s, which is {period:g} s",
        )  # fmt: skip
    gain = 2.0 * getattr(control, "damping", 0.0) * getattr(control, "frequency", 0.0)
    if gain * period > 0.6:
        raise InputError(
            "control.frequency_rad_s", control.frequency,
            f"must be at most {0.3 / (control.damping * period):g} rad/s for a stable attitude "
            f"loop with control.damping = {control.damping:g} and control.period_s = {period:g} s",
        )  # fmt: skip


def _check_tasking(scenario: CheckedTables, sensors: dict[str, Any]) -> None:
    """Check that exactly the sensors that measure on command have a schedule.

    No schedule may ask for more than one measurement per control cycle.
    """
    for name in scenario.tasking:
        if name not in sensors:
            raise InputError(
                f"tasking.{name}",
                name,
                f"must have the name of a sensor, but no sensor is named {name!r}",
                suggestion(name, sensors),
                show_value=False,
            )
        if not sensors[name].is_tasked:
            raise InputError(
                f"tasking.{name}", scenario.tasking[name].kind,
                f"has no effect, because a sensor of kind {scenario.sensors[name].kind!r} measures "
                "in every cycle",
                "Delete the table.", show_value=False,
            )  # fmt: skip
    for name, sensor in sensors.items():
        if sensor.is_tasked and name not in scenario.tasking:
            raise InputError(
                f"sensors.{name}", scenario.sensors[name].kind,
                f"needs a table [tasking.{name}], because a sensor of kind "
                f"{scenario.sensors[name].kind!r} measures only on command",
                show_value=False,
            )  # fmt: skip
    cycle = scenario.simulation.make().cycle
    for name, part in scenario.tasking.items():
        for key, rate in part.table.model_dump().items():
            if key.endswith("_hz") and rate * cycle > 1.0 + 1e-9:
                raise InputError(
                    f"tasking.{name}.{key}", rate,
                    f"must be at most {1.0 / cycle:g} Hz, one measurement per control cycle "
                    f"(simulation.cycle_s = {cycle:g} s)",
                )  # fmt: skip


def _check_all_used(scenario: CheckedTables, sensors: dict[str, Any]) -> None:
    """Check that every sensor, prior map and initial uncertainty is used.

    Cameras and sensors with ``is_recorded`` need no user.
    """
    navigation = scenario.navigation.make()
    used = {name for part in scenario.mappers.values() for name in sensor_names(part.make())}
    wanted = (*navigation.needs, *navigation.accepts)
    if scenario.control.make().torques:
        wanted = (*wanted, InertialSamples)
    for name, sensor in sensors.items():
        if issubclass(sensor.measurement_type, CameraImage) or getattr(
            sensor, "is_recorded", False
        ):
            continue
        if name not in used and not (wanted and issubclass(sensor.measurement_type, wanted)):
            raise InputError(
                f"sensors.{name}", scenario.sensors[name].kind,
                "is not used: no mapper names it, and navigation of kind "
                f"{scenario.navigation.kind!r} "
                f"does not use sensors of kind {scenario.sensors[name].kind!r}",
                "Delete the sensor, or name it in a mapper.", show_value=False,
            )  # fmt: skip
    if scenario.prior_map is not None and not _has_sensor_for(sensors, LidarScan):
        raise InputError(
            "prior_map", "given",
            f"needs a sensor {_sensor_kinds_for(LidarScan)}, whose scans are matched to the map",
            "Add the sensor, or delete [prior_map].", show_value=False,
        )  # fmt: skip
    if scenario.prior_map is not None and not navigation.uses_prior_map:
        raise InputError(
            "prior_map", "given",
            f"is not used by navigation of kind {scenario.navigation.kind!r}",
            "Delete [prior_map].", show_value=False,
        )  # fmt: skip
    if scenario.initial_uncertainty is not None and InertialSamples not in navigation.needs:
        raise InputError(
            "initial_uncertainty", "given",
            f"is not used by navigation of kind {scenario.navigation.kind!r}",
            "Delete [initial_uncertainty].", show_value=False,
        )  # fmt: skip
