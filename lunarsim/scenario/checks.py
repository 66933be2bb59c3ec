"""Check that the parts of a scenario fit together and that none is without effect."""

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


class PartTable(Protocol):
    """A table with a `kind`."""

    @property
    def kind(self) -> str:
        """Registered name or "module:Class"."""
        ...

    @property
    def table(self) -> Any:
        """The other keys of the table."""
        ...

    def make(self) -> Any:
        """Create the part."""
        ...


class CheckedTables(Protocol):
    """The tables of a scenario that the checks read."""

    @property
    def sensors(self) -> Mapping[str, PartTable]:
        """Sensors by name."""
        ...

    @property
    def tasking(self) -> Mapping[str, PartTable]:
        """Tasking schedules by sensor name."""
        ...

    @property
    def mappers(self) -> Mapping[str, PartTable]:
        """Mappers by name."""
        ...

    @property
    def navigation(self) -> PartTable:
        """Navigation filter."""
        ...

    @property
    def control(self) -> PartTable:
        """Attitude control."""
        ...

    @property
    def decisions(self) -> Any:
        """Divert decisions."""
        ...

    @property
    def simulation(self) -> Any:
        """Clock of the simulation."""
        ...

    @property
    def surroundings(self) -> Any:
        """Far terrain, or None."""
        ...

    @property
    def moon(self) -> Any:
        """Rotating sphere with central gravity, or None."""
        ...

    @property
    def prior_map(self) -> Any:
        """Prior map, or None."""
        ...

    @property
    def start_knowledge(self) -> Any:
        """Initial uncertainty of the estimate, or None."""
        ...

    @property
    def vehicle(self) -> PartTable:
        """Lander."""
        ...

    @property
    def sun(self) -> Any:
        """Illumination."""
        ...

    @property
    def faults(self) -> Any:
        """Actuator faults, or None."""
        ...


def check(scenario: CheckedTables) -> None:
    """Check that parts have what they need, are consistent, and have an effect.

    Raises
    ------
    InputError
        Naming the first field that fails a check.
    """
    for table in ("sensors", "tasking", "mappers"):
        _check_names(table, getattr(scenario, table))
    sensors = {name: part.make() for name, part in scenario.sensors.items()}
    _check_single(sensors)
    _check_filters(scenario)
    _check_mappers(scenario, sensors)
    _check_navigation(scenario, sensors)
    _check_control(scenario, sensors)
    _check_actuators(scenario)
    _check_tasking(scenario, sensors)
    _check_effect(scenario, sensors)
    chosen = scenario.decisions.map
    if chosen and chosen not in scenario.mappers:
        raise InputError(
            "decisions.map", chosen, "must be the name of a mapper",
            suggestion(chosen, scenario.mappers),
        )  # fmt: skip


def _check_names(table: str, parts: Mapping[str, PartTable]) -> None:
    """Check that names are valid as names of files, random streams and columns."""
    for name in parts:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", name):
            raise InputError(
                table, name, "must have names of letters, digits, _ and -, starting with a letter"
            )


def _check_single(sensors: dict[str, Any]) -> None:
    """Check that there is at most one sensor of each type that navigation uses once."""
    for only in (InertialSamples, NavigationFix):
        names = [name for name, sensor in sensors.items() if issubclass(sensor.gives, only)]
        if len(names) > 1:
            raise InputError(
                f"sensors.{names[1]}",
                names,
                f"must be the only sensor that measures {only.__name__}",
            )


def _check_filters(scenario: CheckedTables) -> None:
    """Check that at most one mapper adds states to the navigation filter."""
    names = [
        name
        for name, part in scenario.mappers.items()
        if getattr(part.make(), "navigation", None) is not None
    ]
    if len(names) > 1:
        raise InputError(
            f"mappers.{names[1]}",
            names,
            "must be the only mapper that uses the navigation filter",
        )


def _has_sensor_for(sensors: dict[str, Any], wanted: type) -> bool:
    return any(issubclass(sensor.gives, wanted) for sensor in sensors.values())


def _sensor_kinds_for(wanted: type) -> str:
    """Return the kinds of sensors that output a type of measurement, joined by "or"."""
    found = [
        repr(kind)
        for kind, sensor in loadable_parts("sensor")
        if isinstance(sensor.gives, type) and issubclass(sensor.gives, wanted)
    ]
    return " or ".join(found) or f"with measurement type {wanted.__name__}"


def _kinds_of(contract: str, wanted: type) -> str:
    """Return the kinds of a contract with a class or its subclasses, joined by "or"."""
    found = [repr(kind) for kind, part in loadable_parts(contract) if issubclass(part, wanted)]
    return " or ".join(found) or f'"{wanted.__module__}:{wanted.__qualname__}"'


def _check_mappers(scenario: CheckedTables, sensors: dict[str, Any]) -> None:
    for name, part in scenario.mappers.items():
        mapper = part.make()
        field = f"mappers.{name}"
        if isinstance(mapper, FusedMapperSettings):
            _check_other_mappers(field, mapper.chosen, scenario)
            continue
        if isinstance(mapper, ShadowMapping):
            _check_other_mappers(field, mapper.check_terrain_mapper, scenario)
            _check_sun_elevation(field, scenario.sun.elevation_deg)
        _check_map(field, mapper, scenario)
        _check_sensors(field, mapper, sensors)
        wanted = getattr(mapper, "navigation", None)
        if wanted is not None and not isinstance(scenario.navigation.make(), wanted):
            raise InputError(
                "navigation.kind", scenario.navigation.kind,
                f"must be {_kinds_of('navigation', wanted)}, because {field} (kind {part.kind!r}) "
                "uses that filter",
            )  # fmt: skip


def _check_sun_elevation(field: str, elevation: float) -> None:
    """Check that the Sun's elevation is within the range of a shadow mapper."""
    least, most = np.rad2deg([MIN_SUN_ELEVATION, MAX_SUN_ELEVATION])
    if not least - 1e-9 <= elevation <= most + 1e-9:
        raise InputError(
            "sun.elevation_deg", elevation,
            f"must be from {least:.0f} to {most:.0f}, because {field} maps rocks by their shadows",
        )  # fmt: skip


def _check_sensors(field: str, mapper: Any, sensors: dict[str, Any]) -> None:
    """Check that the sensors of a mapper exist and output what it accepts."""
    key = f"{field}.sensors" if getattr(mapper, "sensors", ()) else f"{field}.sensor"
    for name in sensor_names(mapper) or (mapper.sensor,):
        if name not in sensors:
            raise InputError(
                key, name,
                f"must be the name of a sensor of kind {_sensor_kinds_for(mapper.takes)}",
                f"Sensors: {', '.join(sensors) or 'none'}.",
            )  # fmt: skip
        given = sensors[name].gives
        if not issubclass(given, mapper.takes):
            raise InputError(
                key, name,
                f"must be a sensor of kind {_sensor_kinds_for(mapper.takes)}, but measures "
                f"{given.__name__}",
            )  # fmt: skip


def _check_other_mappers(
    field: str, check: Callable[[dict[str, Any]], Any], scenario: CheckedTables
) -> None:
    """Check that the other mappers that a mapper needs exist and provide its input."""
    try:
        check({name: part.make() for name, part in scenario.mappers.items()})
    except InputError as error:
        raise error.renamed(f"{field}.{error.field}") from None


def _check_map(field: str, mapper: Any, scenario: CheckedTables) -> None:
    """Check size and posting of a map, if the mapper has them."""
    size, posting = getattr(mapper, "size", None), getattr(mapper, "posting", None)
    if isinstance(size, float | int) and isinstance(posting, float | int):
        try:
            check_map_size(size, posting, scenario.vehicle.make())
        except InputError as error:
            raise error.renamed(f"{field}.{error.field}") from None


def _check_navigation(scenario: CheckedTables, sensors: dict[str, Any]) -> None:
    navigation = scenario.navigation.make()
    for wanted in navigation.needs:
        if not _has_sensor_for(sensors, wanted):
            raise InputError(
                "navigation.kind", scenario.navigation.kind,
                f"needs a sensor of kind {_sensor_kinds_for(wanted)}",
                "Add it as [sensors.NAME].",
            )  # fmt: skip
    if scenario.surroundings is not None and scenario.moon is None:
        raise InputError(
            "surroundings", "given", "needs a table [moon]", "Add [moon] or omit [surroundings]."
        )
    if scenario.moon is not None and InertialSamples in navigation.needs:
        raise InputError(
            "moon", "given",
            f"is not supported by navigation of kind {scenario.navigation.kind!r}, which assumes "
            "uniform gravity",
            "Omit it, or use navigation of kind 'fixes'.",
        )  # fmt: skip
    if navigation.needs_prior_map and scenario.prior_map is None:
        raise InputError(
            "prior_map", None,
            f"is required, because navigation of kind {scenario.navigation.kind!r} uses it to "
            "find its position",
        )  # fmt: skip


def _check_control(scenario: CheckedTables, sensors: dict[str, Any]) -> None:
    if scenario.control.make().torques and not _has_sensor_for(sensors, InertialSamples):
        raise InputError(
            "control.kind", scenario.control.kind,
            "needs a sensor of kind 'imu'",
            "Add it as [sensors.NAME], or use control of kind 'ideal'.",
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
            f"must be at most {most:g} with damping {damping:g} and an attitude loop period of "
            f"{step:g} s",
        )  # fmt: skip


def _check_actuators(scenario: CheckedTables) -> None:
    """Check that vehicle, control and faults fit together."""
    lander, control = scenario.vehicle.make(), scenario.control.make()
    jets = isinstance(lander, JetLander)
    field, kind = "control.kind", scenario.control.kind
    if jets and not control.torques:
        raise InputError(
            field, kind, f"must command torques, because a vehicle of kind "
            f"{scenario.vehicle.kind!r} is turned by thrusters"
        )  # fmt: skip
    if not jets and hasattr(control, "rate_change"):
        raise InputError(
            field,
            kind,
            f"commands thruster firings and needs a vehicle of kind "
            f"{_kinds_of('vehicle', JetLander)}",
        )
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
        raise InputError("control.period_s", period, f"must be a multiple of the step of {step} s")
    if lander.thrusters.minimum_on > period:
        raise InputError(
            "vehicle.thrusters.minimum_on_s", lander.thrusters.minimum_on,
            f"must be at most the control period of {period} s",
        )  # fmt: skip
    gain = 2.0 * getattr(control, "damping", 0.0) * getattr(control, "frequency", 0.0)
    if gain * period > 0.6:
        raise InputError(
            "control.frequency_rad_s", control.frequency,
            f"must be at most {0.3 / (control.damping * period):g} with a control period of "
            f"{period:g} s",
        )  # fmt: skip


def _check_tasking(scenario: CheckedTables, sensors: dict[str, Any]) -> None:
    for name in scenario.tasking:
        if name not in sensors:
            raise InputError(
                f"tasking.{name}",
                name,
                "must be the name of a sensor",
                suggestion(name, sensors),
            )
        if not sensors[name].tasked:
            raise InputError(
                f"tasking.{name}", scenario.tasking[name].kind,
                f"has no effect, because a sensor of kind {scenario.sensors[name].kind!r} measures "
                "in every cycle",
                "Omit it.",
            )  # fmt: skip
    for name, sensor in sensors.items():
        if sensor.tasked and name not in scenario.tasking:
            raise InputError(
                f"sensors.{name}", scenario.sensors[name].kind,
                f"needs a table [tasking.{name}], because it measures only on command",
            )  # fmt: skip
    cycle = scenario.simulation.make().cycle
    for name, part in scenario.tasking.items():
        for key, rate in part.table.model_dump().items():
            if key.endswith("_hz") and rate * cycle > 1.0 + 1e-9:
                raise InputError(
                    f"tasking.{name}.{key}", rate,
                    f"must be at most {1.0 / cycle:g}, one measurement per control cycle",
                )  # fmt: skip


def _check_effect(scenario: CheckedTables, sensors: dict[str, Any]) -> None:
    """Check that every part is used."""
    navigation = scenario.navigation.make()
    used = {name for part in scenario.mappers.values() for name in sensor_names(part.make())}
    wanted = (*navigation.needs, *navigation.takes)
    if scenario.control.make().torques:
        wanted = (*wanted, InertialSamples)
    for name, sensor in sensors.items():
        if issubclass(sensor.gives, CameraImage):
            continue  # a camera may record
        if name not in used and not (wanted and issubclass(sensor.gives, wanted)):
            raise InputError(
                f"sensors.{name}", scenario.sensors[name].kind,
                "is not used by any mapper, nor by navigation of kind "
                f"{scenario.navigation.kind!r}, which does not accept {sensor.gives.__name__}",
            )  # fmt: skip
    if scenario.prior_map is not None and not _has_sensor_for(sensors, LidarScan):
        raise InputError(
            "prior_map", "given",
            f"needs a sensor of kind {_sensor_kinds_for(LidarScan)}, whose scans are matched to "
            "the map",
            "Add the sensor, or omit [prior_map].",
        )  # fmt: skip
    if scenario.prior_map is not None and not navigation.uses_prior_map:
        raise InputError(
            "prior_map", "given",
            f"is not used by navigation of kind {scenario.navigation.kind!r}",
            "Omit it.",
        )  # fmt: skip
    if scenario.start_knowledge is not None and InertialSamples not in navigation.needs:
        raise InputError(
            "start_knowledge", "given",
            f"is not used by navigation of kind {scenario.navigation.kind!r}",
            "Omit it.",
        )  # fmt: skip
