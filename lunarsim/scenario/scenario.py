"""Define `Scenario`: the complete definition of a study, read from one TOML file.

Keys end in their unit: ``_m``, ``_s``, ``_kg``, ``_n``, ``_deg``, ``_m_s``. Unknown keys, wrong
types and values out of bounds raise an `InputError` with field, value and problem.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import tomli_w
from pydantic import ValidationError

from lunarsim.atomic_files import atomic_write_text
from lunarsim.errors import InputError
from lunarsim.messages.briefing import FlightSoftware
from lunarsim.parts import PartSettings, kinds, resolve, settings_of
from lunarsim.parts.module_permission import allow_modules as permit_modules
from lunarsim.parts.module_permission import allowed_modules
from lunarsim.parts.program_permission import allow_programs, allowed_programs
from lunarsim.scenario import layout
from lunarsim.scenario.checks import check
from lunarsim.scenario.errors import input_error, key_hint, unknown_key_error
from lunarsim.scenario.files import parsed_toml, read_toml
from lunarsim.scenario.resource_estimate import check_memory
from lunarsim.scenario.site_values import with_site_values, without_site_values
from lunarsim.sensors.catalogue import complete_table, with_unit_values

if TYPE_CHECKING:
    from lunarsim.models.lander import Lander
    from lunarsim.scenario import tables
    from lunarsim.vehicle.true_vehicle import VehicleDeviations


@dataclass(frozen=True)
class SelectedPart:
    """Scenario table whose `kind` selects a component, for instance a sensor.

    The keys of the table are attributes, and `make` creates the component.

    Attributes
    ----------
    kind
        Kind of the component: a registered name or "module:Class".
    table
        Values of the keys other than `kind`.
    unit
        Name of the sensor unit whose values the table started from; None: no unit.
    """

    kind: str
    table: PartSettings
    unit: str | None = None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.table, name)

    def make(self) -> Any:
        """Create the component that the table describes, in SI units and radians."""
        return self.table.make()


@dataclass(frozen=True)
class Scenario:
    """Complete definition of a study: world, vehicle, sensors, software, clock.

    Attributes are the tables of the file; `lunarsim scenario reference` lists all keys. Create
    scenarios with `load`, `from_dict` or `changed`, which check all values.
    """

    name: str
    description: str
    gravity_m_s2: float
    site: tables.SiteTable | None
    moon: tables.MoonTable | None
    far_terrain: tables.FarTerrainTable | None
    dust: tables.DustTable | None
    terrain: tables.TerrainTable
    rocks: tables.RocksTable
    sun: tables.SunTable
    vehicle: tables.VehicleTable
    truth: tables.TruthTable
    faults: tables.FaultsTable | None
    legs: tables.LegsTable | None
    domain_randomization: tables.DomainRandomizationTable | None
    start: tables.StartTable
    initial_uncertainty: tables.InitialUncertaintyTable | None
    target: tables.TargetTable
    prior_map: tables.PriorMapTable | None
    expected_rocks: tables.ExpectedRocksTable
    sensors: Mapping[str, tables.SensorsTable]
    sensor_faults: Mapping[str, tables.SensorFaultsTable]
    tasking: Mapping[str, tables.TaskingTable]
    navigation: tables.NavigationTable
    mappers: Mapping[str, tables.MappersTable]
    policy: tables.PolicyTable
    decisions: tables.DecisionsTable
    approach: tables.ApproachTable
    guidance: tables.GuidanceTable
    braking: tables.BrakingTable | None
    window: tables.WindowTable | None
    terminal_descent: tables.TerminalDescentTable | None
    control: tables.ControlTable
    computer: tables.ComputerTable | None
    command_delay: tables.CommandDelayTable | None
    simulation: tables.SimulationTable
    record: tables.RecordTable | None
    site_reward: tables.SiteRewardTable | None
    descent_reward: tables.DescentRewardTable | None

    @classmethod
    def from_dict(
        cls, data: Mapping[str, Any], folder: Path | None = None, *,
        allow_modules: Collection[str] = (),
    ) -> Scenario:  # fmt: skip
        """Create and check a scenario from nested dictionaries.

        Parameters
        ----------
        data
            Tables and keys as in the TOML file.
        folder
            Folder of relative paths; None is the working directory.
        allow_modules
            Modules that a `kind` may name as "module:Class", from now on in this process.

        Raises
        ------
        InputError
            Naming the first invalid field.

        Examples
        --------
        >>> Scenario.from_dict({"rocks": {"cover": 0.1}}).rocks.cover
        0.1
        """
        permit_modules(*allow_modules)
        scenario = cls._unchecked(data, folder)
        check(scenario)
        check_memory(scenario)
        return scenario

    @classmethod
    def _unchecked(cls, data: Mapping[str, Any], folder: Path | None) -> Scenario:
        """Create a scenario from nested dictionaries, and check each table separately.

        `folder` is the folder of relative paths; None is the working directory.
        """
        known = [f.name for f in fields(cls)]
        for key, value in data.items():
            if key not in known:
                moved = layout.MOVED_TABLES.get(key)
                hint = f"Use {moved} instead." if moved else key_hint(key, known)
                raise unknown_key_error(key, value, hint)
        values: dict[str, Any] = {
            "name": _text(data, "name", "unnamed"),
            "description": _text(data, "description", ""),
            "gravity_m_s2": _number(data, "gravity_m_s2", 1.622),
        }
        if not values["name"]:
            raise InputError("name", "", "must not be empty")
        if "site" in data:
            site = _table("site", layout.OPTIONAL["site"], data["site"], folder)
            data = with_site_values(data, site.make())
        for key, part_class in layout.FIXED.items():
            values[key] = _table(key, part_class, data.get(key, {}), folder)
        for key, part_class in layout.OPTIONAL.items():
            given = key in data
            values[key] = _table(key, part_class, data[key], folder) if given else None
        for key, contract in layout.OPTIONAL_SELECTED.items():
            given = key in data
            values[key] = _selected_part(key, contract, data[key], None, folder) if given else None
        for key, (contract, _) in layout.SELECTED.items():
            kind = layout.default_kind(key, data)
            values[key] = _selected_part(key, contract, data.get(key, {}), kind, folder)
        for key, (contract, default) in layout.NAMED.items():
            tables = _mapping(key, data.get(key, default))
            values[key] = {
                name: _selected_part(f"{key}.{name}", contract, table, None, folder)
                for name, table in tables.items()
            }
        return cls(**values)

    @classmethod
    def load(cls, path: str | Path, *, allow_modules: Collection[str] = ()) -> Scenario:
        """Read a scenario from a TOML file.

        Parameters
        ----------
        path
            TOML file. Relative paths in it start from its folder.
        allow_modules
            Modules that a `kind` may name as "module:Class", from now on in this process.

        Raises
        ------
        InputError
            If the file is missing or not TOML, or a field is invalid.
        """
        path = Path(path)
        tables = read_toml(path, "scenario")
        return cls.from_dict(tables, path.parent.resolve(), allow_modules=allow_modules)

    @classmethod
    def from_toml(cls, text: str, *, allow_modules: Collection[str] = ()) -> Scenario:
        """Create a scenario from TOML text with absolute paths.

        Parameters
        ----------
        text
            Contents of a TOML file.
        allow_modules
            Modules that a `kind` may name as "module:Class", from now on in this process.

        Raises
        ------
        InputError
            If the text is not TOML, or a field is invalid.
        """
        return cls.from_dict(parsed_toml(text), allow_modules=allow_modules)

    @classmethod
    def world_from_toml(cls, text: str, folder: Path | None = None) -> Scenario:
        """Create a scenario from only the world and vehicle tables of a TOML text.

        All other tables have their defaults, because their components may come from modules that
        this process does not allow. Readers of flight records and reports use this method. `folder`
        is the folder of relative paths; None is the working directory.

        Raises
        ------
        InputError
            Naming the first invalid field.
        """
        data = parsed_toml(text)
        scenario = cls._unchecked(
            {key: data[key] for key in layout.WORLD_KEYS if key in data}, folder
        )
        check_memory(scenario)
        return scenario

    def changed(self, /, **changes: Unpack[tables.Changes]) -> Scenario:
        """Return a checked copy of the scenario with some values changed.

        Parameters
        ----------
        changes
            Changes by table, for example ``changed(sun={"elevation_deg": 5.0})``. A part of another
            `kind` starts from its own defaults. None removes a named part or an optional table.
            If navigation has its default value, the default is determined again for the changed
            sensors and mappers. Values that follow from the site are found again. A change of
            its date replaces the directions of Sun and Earth; a change of a direction removes the
            date.

        Raises
        ------
        InputError
            Naming the first invalid field.

        Examples
        --------
        >>> study = Scenario.from_dict({"name": "rocky"}).changed(rocks={"cover": 0.1})
        >>> study.name, study.rocks.cover
        ('rocky', 0.1)
        """
        data = self.to_dict()
        left_out = {"kind": layout.default_kind("navigation", data)}
        if "navigation" not in changes and self.navigation == _selected_part(
            "navigation", "navigation", left_out, None, None
        ):
            del data["navigation"]
        site = None if self.site is None else self.site.make()
        data = without_site_values(data, site, changes)
        for key, change in changes.items():
            data[key] = _merged(key, data.get(key), change)
            if data[key] is None and hasattr(self, key):
                del data[key]
        return self.from_dict(data)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the scenario as nested dictionaries, which are checked again on loading."""
        return _from_process, (self.to_dict(), allowed_modules(), allowed_programs())

    def software(self) -> FlightSoftware:
        """Create the settings of all software that runs on the onboard computer."""
        return FlightSoftware(
            navigation=self.navigation.make(),
            guidance=self.guidance.make(),
            control=self.control.make(),
            tasking={name: part.make() for name, part in self.tasking.items()},
            mappers={name: part.make() for name, part in self.mappers.items()},
            approach=self.approach.make(),
            decisions=self.decisions.make(),
            terminal_descent=None
            if self.terminal_descent is None
            else self.terminal_descent.make(),
            braking=None if self.braking is None else self.braking.make(),
            designation_window=None if self.window is None else self.window.make(),
            computer=None if self.computer is None else self.computer.make(),
        )

    def check_hover(self) -> None:
        """Raise InputError unless the lander can hover, and descend at the end."""
        self.vehicle.make().check_hover(self.gravity_m_s2, self.approach.make().reserve)

    def true_lander(self) -> Lander:
        """Create the true lander: `[vehicle]` with the deviations of `[truth.vehicle]`.

        Raises
        ------
        InputError
            If the deviations give an impossible lander.
        """
        nominal: Lander = self.vehicle.make()
        deviations: VehicleDeviations = self.truth.make().vehicle
        return deviations.true_lander(nominal)

    def to_dict(self) -> dict[str, Any]:
        """Return all values of the scenario as nested dictionaries, including defaults.

        Optional tables that the scenario does not have are omitted.
        """
        out: dict[str, Any] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if value is None or (f.name == "sensor_faults" and not value):
                continue
            if f.name in layout.NAMED:
                out[f.name] = {name: _dump(part) for name, part in value.items()}
            else:
                out[f.name] = _dump(value)
        return out

    def to_toml(self) -> str:
        """Return the scenario as TOML text, including defaults."""
        return tomli_w.dumps(self.to_dict())

    def check_files(self) -> None:
        """Read the terrain files to check them; other parts read their files on creation.

        Terrain without a file passes.

        Raises
        ------
        InputError
            If a file cannot be read, or is not usable as terrain.
        """
        check = getattr(self.terrain.make(), "check_files", None)
        if check is not None:
            check()

    def save(self, path: str | Path) -> None:
        """Write the scenario to a TOML file, including defaults."""
        atomic_write_text(Path(path), self.to_toml())


def _from_process(
    tables: dict[str, Any], modules: tuple[str, ...], programs: tuple[Path, ...]
) -> Scenario:
    """Unpickle a scenario; allow what the pickling process allowed."""
    allow_programs(*programs)
    return Scenario.from_dict(tables, allow_modules=modules)


def _dump(value: Any) -> Any:
    if isinstance(value, SelectedPart):
        unit = {} if value.unit is None else {"unit": value.unit}
        return {"kind": value.kind, **unit, **_dump(value.table)}
    if isinstance(value, PartSettings):
        return value.model_dump(mode="json", exclude_none=True)
    return value


def _merged(path: str, old: Any, change: Any) -> Any:
    """Return the scenario value or table `old` of a path with `change` merged into it.

    Tables are merged key by key, and None removes a key. A change that is not a table, or that has
    another `kind`, replaces `old` completely.
    """
    if not (isinstance(old, dict) and isinstance(change, Mapping)):
        return change
    if re.fullmatch(r"sensors\.[^.]+", path):
        change = with_unit_values(path, change, old.get("kind", ""))
    if "kind" in change and change["kind"] != old.get("kind", change["kind"]):
        return dict(change)
    new = dict(old)
    for key, value in change.items():
        new[key] = _merged(f"{path}.{key}", old.get(key), value)
        if new[key] is None:
            del new[key]
    return new


def _text(data: Mapping[str, Any], key: str, default: str) -> str:
    value = data.get(key, default)
    if not isinstance(value, str):
        raise InputError(key, value, "must be a text in quotes")
    if any(unicodedata.category(c) == "Cc" and c not in "\n\t" for c in value):
        raise InputError(key, value, "must not contain control characters")
    return value


def _number(data: Mapping[str, Any], key: str, default: float) -> float:
    value = data.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < 1e3:
        raise InputError(key, value, "must be a positive number below 1000, in m/s^2")
    return float(value)


def _mapping(path: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(path, value, f"must be a table [{path}]")
    return value


def _selected_part(
    path: str, contract: str, value: Any, default: str | None, folder: Path | None
) -> SelectedPart:
    if isinstance(value, str):
        raise InputError(path, value, f'must be a table [{path}] with kind = "{value}"')
    data = dict(_mapping(path, value))
    unit = None
    if contract == "sensor":
        data = complete_table(path, data)
        unit = data.pop("unit", None)
    kind = data.pop("kind", default)
    if not isinstance(kind, str):
        problem = "is required" if kind is None else "must be a text in quotes"
        known = f"Known names: {', '.join(kinds(contract))}."
        raise InputError(f"{path}.kind", kind, problem, known, kind is not None)
    part_class = resolve(contract, kind, f"{path}.kind")
    return SelectedPart(kind, _table(path, part_class, data, folder, contract, kind), unit)


def _absolute_path(field: str, path: Path, folder: Path | None) -> Path:
    """Return an absolute path; a relative path starts from `folder`.

    If `folder` is None, it starts from the working directory. `field` is the scenario key for
    errors.
    """
    try:
        return ((Path.cwd() if folder is None else folder) / path).resolve()
    except (ValueError, OSError, RuntimeError) as error:
        raise InputError(field, str(path), f"must be a valid path ({error})") from None


def _table(
    path: str,
    part_class: type,
    value: Any,
    folder: Path | None,
    contract: str | None = None,
    kind: str = "",
) -> PartSettings:
    """Check a scenario table and return it as settings.

    The component is created once to check the values. `path` is the name of the table,
    `part_class` the class that it configures, and `folder` the folder of relative paths.
    `contract` and `kind` are given for a table with a `kind`.
    """
    try:
        model = settings_of(part_class)
    except Exception as error:  # pydantic raises many types for custom annotations
        message = str(error).split("\n")[0]
        raise InputError(
            f"{path}.kind",
            kind or part_class.__name__,
            f"must have fields with types that TOML supports ({message})",
        ) from error
    try:
        table = model.model_validate(dict(_mapping(path, value)))
    except ValidationError as error:
        raise input_error(path, model, error, contract, kind) from None
    paths = {
        key: _absolute_path(f"{path}.{key}", given, folder)
        for key in model.model_fields
        if isinstance(given := getattr(table, key), Path)
    }
    if paths:
        table = model.model_validate(table.model_dump() | paths)
    try:
        table.make()
    except InputError as error:
        raise error.with_field(f"{path}.{error.field}") from None
    return table
