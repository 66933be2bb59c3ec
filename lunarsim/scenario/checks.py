"""Parts that need each other, and parts that have no effect."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from lunarsim.errors import InputError, suggestion
from lunarsim.messages.measurements import InertialSamples, LidarScan, NavigationFix, Picture
from lunarsim.models.jet_lander import JetLander
from lunarsim.onboard.hazards.fusion import FusedMapping
from lunarsim.onboard.hazards.mapper import check_map, sensors_of
from lunarsim.onboard.hazards.shadows.mapping import ShadowMapping
from lunarsim.onboard.perception.shadow_model import LEAST_ELEVATION, MOST_ELEVATION
from lunarsim.parts import loadable


class Chosen(Protocol):
    """A table with a kind."""

    @property
    def kind(self) -> str:
        """Registered name or "module:Class"."""
        ...

    @property
    def table(self) -> Any:
        """The rest of the table."""
        ...

    def make(self) -> Any:
        """Return the part."""
        ...


class Tables(Protocol):
    """What is checked of a scenario."""

    @property
    def sensors(self) -> Mapping[str, Chosen]:
        """By name."""
        ...

    @property
    def tasking(self) -> Mapping[str, Chosen]:
        """By the name of the sensor."""
        ...

    @property
    def mappers(self) -> Mapping[str, Chosen]:
        """By name."""
        ...

    @property
    def navigation(self) -> Chosen:
        """One part."""
        ...

    @property
    def control(self) -> Chosen:
        """One part."""
        ...

    @property
    def decisions(self) -> Any:
        """A fixed table."""
        ...

    @property
    def simulation(self) -> Any:
        """A fixed table."""
        ...

    @property
    def surroundings(self) -> Any:
        """A table or None."""
        ...

    @property
    def moon(self) -> Any:
        """A table or None."""
        ...

    @property
    def prior_map(self) -> Any:
        """A table or None."""
        ...

    @property
    def start_knowledge(self) -> Any:
        """A table or None."""
        ...

    @property
    def vehicle(self) -> Chosen:
        """One part."""
        ...

    @property
    def sun(self) -> Any:
        """A table."""
        ...

    @property
    def faults(self) -> Any:
        """A table or None."""
        ...


def check(scenario: Tables) -> None:
    """Raise `InputError` for parts that lack another, contradict another, or have no effect."""
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
        raise InputError("decisions.map", chosen, suggestion(chosen, scenario.mappers))


def _check_names(table: str, parts: Mapping[str, Chosen]) -> None:
    """Refuse names that are no good as names of files, streams and columns."""
    for name in parts:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", name):
            raise InputError(table, name, "names of letters, digits, _ and -, a letter first")


def _check_single(sensors: dict[str, Any]) -> None:
    """Refuse a second sensor of a kind that navigation takes for the only one."""
    for only in (InertialSamples, NavigationFix):
        names = [name for name, sensor in sensors.items() if issubclass(sensor.gives, only)]
        if len(names) > 1:
            raise InputError(
                f"sensors.{names[1]}", names, f"at most one sensor that gives {only.__name__}"
            )


def _check_filters(scenario: Tables) -> None:
    """Refuse a second mapper that adds its own states to the one filter of navigation."""
    names = [
        name
        for name, part in scenario.mappers.items()
        if getattr(part.make(), "navigation", None) is not None
    ]
    if len(names) > 1:
        raise InputError(
            f"mappers.{names[1]}", names, "at most one mapper that shares the filter of navigation"
        )


def _gives(sensors: dict[str, Any], wanted: type) -> bool:
    return any(issubclass(sensor.gives, wanted) for sensor in sensors.values())


def _kinds_giving(wanted: type) -> str:
    """Return the kinds of sensors that give a type of measurement, in words."""
    found = [
        repr(kind)
        for kind, sensor in loadable("sensor")
        if isinstance(sensor.gives, type) and issubclass(sensor.gives, wanted)
    ]
    return " or ".join(found) or f"a part that gives {wanted.__name__}"


def _kinds_of(contract: str, wanted: type) -> str:
    """Return the kinds of a contract whose class is one, or is derived from it, in words."""
    found = [repr(kind) for kind, part in loadable(contract) if issubclass(part, wanted)]
    return " or ".join(found) or f'"{wanted.__module__}:{wanted.__qualname__}"'


def _check_mappers(scenario: Tables, sensors: dict[str, Any]) -> None:
    for name, part in scenario.mappers.items():
        mapper = part.make()
        field = f"mappers.{name}"
        if isinstance(mapper, FusedMapping):
            _check_others(field, mapper.chosen, scenario)
            continue
        if isinstance(mapper, ShadowMapping):
            _check_others(field, mapper.check_ground, scenario)
            _check_shadows(field, scenario.sun.elevation_deg)
        _check_map(field, mapper, scenario)
        _check_eyes(field, mapper, sensors)
        wanted = getattr(mapper, "navigation", None)
        if wanted is not None and not isinstance(scenario.navigation.make(), wanted):
            raise InputError(
                "navigation.kind", scenario.navigation.kind,
                f"{_kinds_of('navigation', wanted)}: {field} of kind {part.kind!r} maps with that "
                "filter",
            )  # fmt: skip


def _check_shadows(field: str, elevation: float) -> None:
    """Refuse a Sun under which a mapper of shadows sees none."""
    least, most = np.rad2deg([LEAST_ELEVATION, MOST_ELEVATION])
    if not least - 1e-9 <= elevation <= most + 1e-9:
        raise InputError(
            "sun.elevation_deg", elevation,
            f"from {least:.0f} to {most:.0f}: {field} maps rocks by their shadows",
        )  # fmt: skip


def _check_eyes(field: str, mapper: Any, sensors: dict[str, Any]) -> None:
    """Refuse a mapper of sensors that there are not, or that give what it does not take."""
    key = f"{field}.sensors" if getattr(mapper, "sensors", ()) else f"{field}.sensor"
    for name in sensors_of(mapper) or (mapper.sensor,):
        if name not in sensors:
            raise InputError(
                key, name,
                f"the name of a sensor of kind {_kinds_giving(mapper.takes)}; there are "
                + (", ".join(sensors) or "none"),
            )  # fmt: skip
        given = sensors[name].gives
        if not issubclass(given, mapper.takes):
            raise InputError(
                key, name,
                f"a sensor of kind {_kinds_giving(mapper.takes)}: this one gives {given.__name__}",
            )  # fmt: skip


def _check_others(field: str, check: Callable[[dict[str, Any]], Any], scenario: Tables) -> None:
    """Refuse a mapper that asks for others that there are not, or that cannot tell it."""
    try:
        check({name: part.make() for name, part in scenario.mappers.items()})
    except InputError as error:
        raise error.renamed(f"{field}.{error.field}") from None


def _check_map(field: str, mapper: Any, scenario: Tables) -> None:
    """Refuse a map that is too small, too coarse or too large, where the mapper says how large."""
    size, posting = getattr(mapper, "size", None), getattr(mapper, "posting", None)
    if isinstance(size, float | int) and isinstance(posting, float | int):
        try:
            check_map(size, posting, scenario.vehicle.make())
        except InputError as error:
            raise error.renamed(f"{field}.{error.field}") from None


def _check_navigation(scenario: Tables, sensors: dict[str, Any]) -> None:
    navigation = scenario.navigation.make()
    for wanted in navigation.needs:
        if not _gives(sensors, wanted):
            raise InputError(
                "navigation.kind", scenario.navigation.kind,
                f"needs a sensor of kind {_kinds_giving(wanted)}: add it under [sensors.NAME]",
            )  # fmt: skip
    if scenario.surroundings is not None and scenario.moon is None:
        raise InputError("surroundings", "given", "left out, or a table [moon]: they lie on it")
    if scenario.moon is not None and InertialSamples in navigation.needs:
        raise InputError(
            "moon", "given",
            f"left out, or navigation of kind 'fixes': kind {scenario.navigation.kind!r} knows "
            "uniform gravity alone",
        )  # fmt: skip
    if navigation.needs_prior_map and scenario.prior_map is None:
        raise InputError(
            "prior_map", None,
            f"a table [prior_map]: navigation of kind {scenario.navigation.kind!r} finds its place "
            "on it",
        )  # fmt: skip


def _check_control(scenario: Tables, sensors: dict[str, Any]) -> None:
    if scenario.control.make().torques and not _gives(sensors, InertialSamples):
        raise InputError(
            "control.kind", scenario.control.kind,
            "needs a sensor of kind 'imu': add it under [sensors.NAME], or take control of kind "
            "'ideal'",
        )  # fmt: skip
    step = scenario.simulation.make().step
    frequency = getattr(scenario.control.make(), "frequency", 0.0)
    damping = getattr(scenario.control.make(), "damping", 0.0)
    # Sampled: the rate's feedback 2 damping frequency must be well below 2 / step, and the attitude
    # loop must not lose its phase to a lag of one and a half steps.
    if frequency * step > 0.15 or 2.0 * damping * frequency * step > 0.4:
        most = min(0.15 / step, 0.2 / (damping * step) if damping else np.inf)
        raise InputError(
            "control.frequency_rad_s", frequency,
            f"at most {most:g} with damping {damping:g}: the attitude loop runs every {step:g} s",
        )  # fmt: skip


def _check_actuators(scenario: Tables) -> None:
    """Refuse a vehicle, control and faults that do not go together."""
    lander, control = scenario.vehicle.make(), scenario.control.make()
    jets = isinstance(lander, JetLander)
    field, kind = "control.kind", scenario.control.kind
    if jets and not control.torques:
        raise InputError(
            field, kind, f"a law that turns the lander: vehicle of kind {scenario.vehicle.kind!r} "
            "is turned by its thrusters"
        )  # fmt: skip
    if not jets and hasattr(control, "rate_change"):
        raise InputError(
            field, kind, f"{_kinds_of('vehicle', JetLander)} as vehicle: it orders firings"
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
        raise InputError("control.period_s", period, f"a whole number of steps of {step} s")
    if lander.thrusters.minimum_on > period:
        raise InputError(
            "vehicle.thrusters.minimum_on_s", lander.thrusters.minimum_on,
            f"at most the control's period of {period} s",
        )  # fmt: skip
    gain = 2.0 * getattr(control, "damping", 0.0) * getattr(control, "frequency", 0.0)
    if gain * period > 0.6:
        raise InputError(
            "control.frequency_rad_s", control.frequency,
            f"at most {0.3 / (control.damping * period):g}: pulses come every {period:g} s",
        )  # fmt: skip


def _check_tasking(scenario: Tables, sensors: dict[str, Any]) -> None:
    for name in scenario.tasking:
        if name not in sensors:
            raise InputError(
                f"tasking.{name}", name, "the name of a sensor; " + suggestion(name, sensors)
            )
        if not sensors[name].tasked:
            raise InputError(
                f"tasking.{name}", scenario.tasking[name].kind,
                f"nothing: a sensor of kind {scenario.sensors[name].kind!r} measures every cycle",
            )  # fmt: skip
    for name, sensor in sensors.items():
        if sensor.tasked and name not in scenario.tasking:
            raise InputError(
                f"sensors.{name}", scenario.sensors[name].kind,
                f"a table [tasking.{name}]: it measures only when it is told to",
            )  # fmt: skip
    cycle = scenario.simulation.make().cycle
    for name, part in scenario.tasking.items():
        for key, rate in part.table.model_dump().items():
            if key.endswith("_hz") and rate * cycle > 1.0 + 1e-9:
                raise InputError(
                    f"tasking.{name}.{key}", rate,
                    f"at most {1.0 / cycle:g}, one measurement a control cycle",
                )  # fmt: skip


def _check_effect(scenario: Tables, sensors: dict[str, Any]) -> None:
    """Refuse parts that nothing uses."""
    navigation = scenario.navigation.make()
    used = {name for part in scenario.mappers.values() for name in sensors_of(part.make())}
    wanted = (*navigation.needs, *navigation.takes)
    if scenario.control.make().torques:
        wanted = (*wanted, InertialSamples)
    for name, sensor in sensors.items():
        if issubclass(sensor.gives, Picture):
            continue  # a camera may record
        if name not in used and not (wanted and issubclass(sensor.gives, wanted)):
            raise InputError(
                f"sensors.{name}", scenario.sensors[name].kind,
                "a sensor that some part uses: no mapper maps it, and navigation of kind "
                f"{scenario.navigation.kind!r} does not take {sensor.gives.__name__}",
            )  # fmt: skip
    if scenario.prior_map is not None and not _gives(sensors, LidarScan):
        raise InputError(
            "prior_map", "given",
            f"left out, or a sensor of kind {_kinds_giving(LidarScan)}: its scans find their "
            "place on the map",
        )  # fmt: skip
    if scenario.prior_map is not None and not navigation.uses_prior_map:
        raise InputError(
            "prior_map", "given",
            f"left out: navigation of kind {scenario.navigation.kind!r} does not use it",
        )  # fmt: skip
    if scenario.start_knowledge is not None and InertialSamples not in navigation.needs:
        raise InputError(
            "start_knowledge", "given",
            f"left out: navigation of kind {scenario.navigation.kind!r} does not use it",
        )  # fmt: skip
