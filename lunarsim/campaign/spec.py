"""Specification of a campaign: one TOML file that defines all flights.

name = "rocks-and-policies"
scenario = "golombek.toml"          # relative to this file; or a name, or a table
flights = 200
seed = 1

[factors]                           # all combinations; or [[arms]] with name and set
policy = ["no-divert", "safest"]
"expected_rocks.cover" = [0.02, 0.1]

[dispersions]
"start.position_m.0" = { kind = "normal", mean = -600.0, sigma = 30.0 }

[[correlations]]
keys = ["start.position_m.0", "start.velocity_m_s.0"]
matrix = [[1.0, 0.5], [0.5, 1.0]]

[stop]                              # with method monte-carlo only
metric = "safe"
width = 0.1
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import tomli_w

from lunarsim.campaign.dispersion_checks import check_dispersions, check_no_overlap
from lunarsim.campaign.dispersions import EXTENSIBLE_METHODS, Dispersions, build_dispersions
from lunarsim.campaign.distributions import KINDS, Choice, build_settings
from lunarsim.campaign.factors import (
    Arm,
    build_arms,
    flatten_keys,
    parse_arms,
    product,
)
from lunarsim.campaign.plan import MAX_FLIGHTS
from lunarsim.campaign.provenance import file_digests, module_digest, part_digests
from lunarsim.errors import InputError, suggestion
from lunarsim.evaluation.flight_metrics import COLUMNS
from lunarsim.parts import module_permission, quantity, settings_of
from lunarsim.scenario import Scenario, shipped
from lunarsim.scenario.changes import with_values
from lunarsim.scenario.files import read_toml
from lunarsim.scenario.layout import SELECTED

# Number of draws whose extremes are checked against the scenario before the first flight.
_MAX_CHECKED_DRAWS = 1000
RECORDS = ("none", "failures", "all")


@dataclass(frozen=True)
class CampaignSettings:
    """Top-level keys of a campaign file: name, number of flights, seed and method.

    Attributes
    ----------
    name
        Name of the campaign.
    flights
        Number of flights of each arm (variant of the scenario); with method subset, of each level.
    seed
        Root seed.
    method
        Sampling method of the dispersions: monte-carlo, latin-hypercube, sobol, saltelli,
        importance or subset.
    time_limit
        Wall-clock time after which a flight is aborted, s; None: no limit.
    time_budget
        Wall-clock time after which no more flights start, s; None: no limit.
    records
        Flights whose complete records are kept: none, failures or all.
    figures
        Whether to plot the first flight of each arm and every flight that was not safe.
    """

    name: str = quantity("campaign", help="name of the campaign")
    flights: int = quantity(
        20, ge=1, le=MAX_FLIGHTS, help="number of flights of each variant of the scenario"
    )
    seed: int = quantity(1, ge=0, lt=2**63, help="seed from which all random numbers derive")
    method: str = quantity("monte-carlo", help="method that samples the random scenario values")
    time_limit: float | None = quantity(
        None, "s", gt=0, help="wall-clock time limit of a flight; omitted: none"
    )
    time_budget: float | None = quantity(
        None,
        "s",
        gt=0,
        help="wall-clock time of the campaign after which no flight starts; omitted: none",
    )
    records: str = quantity(
        "none", help="flights whose complete records are stored: none, failures or all"
    )
    figures: bool = quantity(
        False, help="whether to plot the first flight of each variant and every failed flight"
    )

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("name", self.name, "must not be empty")
        if self.records not in RECORDS:
            raise InputError(
                "records", self.records, "is unknown", suggestion(self.records, RECORDS)
            )
        if self.method == "sobol" and self.flights & (self.flights - 1):
            below = 1 << (self.flights.bit_length() - 1)
            raise InputError(
                "flights", self.flights,
                f"must be a power of two with method = 'sobol', for instance {below} or "
                f"{2 * below}",
            )  # fmt: skip


@dataclass(frozen=True)
class StopSettings:
    """Rule that stops a campaign once a confidence interval is narrow enough.

    Attributes
    ----------
    metric
        Boolean column of the results.
    width
        Width of the 95 % confidence sequence of the fraction of flights for which the metric is
        true. The campaign stops once it is reached in every arm.
    """

    metric: str = quantity("safe", help="boolean column of the results whose fraction is estimated")
    width: float = quantity(
        0.1, gt=0, lt=1, help="width of the 95 % confidence sequence at which the campaign stops"
    )

    def __post_init__(self) -> None:
        known = [name for name, kind in COLUMNS.items() if kind == "bool"]
        if self.metric not in known:
            raise InputError(
                "metric", self.metric, "must be a boolean column of the results",
                suggestion(self.metric, known),
            )  # fmt: skip


@dataclass(frozen=True)
class CampaignSpec:
    """Complete specification of a campaign; create it by `load` or `from_dict`.

    Attributes
    ----------
    head
        Top-level keys.
    scenario
        Scenario that all arms modify.
    arms
        Variants of the scenario that are compared.
    dispersions
        Random scenario values of each flight.
    stop
        Early-stopping rule, or None.
    factors
        Lists of values by scenario key, whose combinations are the arms; empty if the campaign file
        lists the arms.
    """

    head: CampaignSettings
    scenario: Scenario
    arms: tuple[Arm, ...]
    dispersions: Dispersions
    stop: StopSettings | None = None
    factors: Mapping[str, list[Any]] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path, *, allow_modules: Collection[str] = ()) -> CampaignSpec:
        """Read a campaign from a TOML file; relative paths in it start from its folder.

        `allow_modules` lists the modules that a `kind` in the file may name as "module:Class".

        Raises
        ------
        InputError
            If the file is missing, is not TOML, or has an invalid value.
        """
        module_permission.allow_modules(*allow_modules)
        path = Path(path)
        data = read_toml(path, "spec")
        return cls.from_dict({"name": path.stem} | data, path.parent.resolve())

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], folder: Path | None = None) -> CampaignSpec:
        """Build a campaign specification from nested dictionaries, as in the TOML file.

        `folder` is the folder of relative paths; None is the working directory.

        Raises
        ------
        InputError
            Naming the first invalid field.
        """
        rest = dict(data)
        tables = {name: rest.pop(name, None) for name in _TABLES}
        if folder is not None:
            paths = {name: _resolve_paths(tables[name], folder) for name in _WITH_PATHS}
            tables |= paths
        head = _head(rest)
        scenario = _scenario(tables["scenario"], folder)
        factors, arms = _arms(scenario, tables["factors"], tables["arms"])
        dispersions = build_dispersions(tables, head.method, head.seed, head.flights)
        stop = (
            None if tables["stop"] is None else build_settings("stop", StopSettings, tables["stop"])
        )
        if stop is not None and head.method != "monte-carlo":
            raise InputError(
                "stop", head.method, "is allowed only with method = 'monte-carlo', but method is "
                f"{head.method!r}", "Delete [stop].", show_value=False,
            )  # fmt: skip
        if head.method == "subset" and len(arms) > 1:
            raise InputError(
                "factors" if arms[0].values and tables["arms"] is None else "arms", len(arms),
                "must contain exactly one arm if method = 'subset'",
                "Write a separate campaign file for each arm.",
            )  # fmt: skip
        spec = cls(head, scenario, arms, dispersions, stop, factors)
        if spec.max_flights * len(arms) > MAX_FLIGHTS:
            most = (
                f"must give at most {MAX_FLIGHTS:,} flights of all arms and levels together, but "
                f"gives {spec.max_flights * len(arms):,}"
            )
            raise InputError("flights", head.flights, most)
        spec.check_draws()
        return spec

    @property
    def max_flights(self) -> int:
        """Maximum number of flights of each arm; with method subset, of all levels.

        An arm is a variant of the scenario.
        """
        subset, count = self.dispersions.subset, self.head.flights
        if subset is None:
            return count
        return count + (subset.levels - 1) * (count - count // subset.steps)

    def scenario_of(self, flight: int, arm: int) -> Scenario:
        """Return the scenario of a flight: the arm's scenario with its random values.

        An arm is a variant of the scenario. `flight` and `arm` are indices.
        """
        return with_values(self.arms[arm].scenario, self.dispersions.draws(flight), "dispersions")

    def check_draws(self) -> None:
        """Check that every arm accepts the extreme random values of each scenario key.

        An arm is a variant of the scenario. The extremes of the first thousand flights are checked.

        Raises
        ------
        InputError
            If an arm sets a key that is also random, or the scenario refuses a random value.
        """
        for arm in self.arms:
            check_no_overlap(arm.values, {k: [v] for k, v in arm.values.items()}, "arms")
        set_by_arms = {key: value for arm in self.arms for key, value in arm.values.items()}
        check_dispersions(
            self.dispersions, [arm.scenario for arm in self.arms], set_by_arms, self.head.flights
        )

    @cached_property
    def identity(self) -> dict[str, Any]:
        """Values of the specification that determine the results, as nested dictionaries.

        Time limits and the choice of outputs are excluded.
        """
        data = self.to_dict()
        for key in ("time_limit_s", "time_budget_s", "figures", "records"):
            data.pop(key, None)
        if self.head.method in EXTENSIBLE_METHODS and self.stop is None:
            data.pop("flights")
        return data | self._dependencies()

    def _dependencies(self) -> dict[str, Any]:
        """Return digests of data files and external code that the flights depend on."""
        found: dict[str, str] = {}
        for arm in self.arms:
            tables = arm.scenario.to_dict()
            found |= file_digests(tables) | part_digests(tables)
            if arm.policy is not None:
                found |= module_digest(type(arm.policy).__module__)
        for key, law in self.dispersions.distributions.items():
            for value in law.values if isinstance(law, Choice) else ():
                tables = {"kind" if key in SELECTED else key.rpartition(".")[2]: value}
                found |= file_digests(tables) | part_digests(tables)
        return {"made from": dict(sorted(found.items()))} if found else {}

    def to_dict(self) -> dict[str, Any]:
        """Return the campaign as nested dictionaries that contain the complete scenario."""
        head = {k: v for k, v in _keys(self.head).items() if v is not None}
        out: dict[str, Any] = {**head, "scenario": self.scenario.to_dict()}
        if self.factors:
            out["factors"] = dict(self.factors)
        else:
            out["arms"] = [{"name": arm.name, "set": _arm_values(arm)} for arm in self.arms]
        laws = self.dispersions.distributions
        if laws:
            out["dispersions"] = {key: _distribution_table(law) for key, law in laws.items()}
        if self.dispersions.correlations:
            out["correlations"] = [
                {"keys": list(c.keys), "matrix": [list(row) for row in c.matrix]}
                for c in self.dispersions.correlations
            ]
        importance = self.dispersions.importance
        if importance is not None:
            values = {f.name: _plain(getattr(importance, f.name)) for f in fields(importance)}
            out["importance"] = {k: v for k, v in values.items() if v is not None}
        subset = self.dispersions.subset
        if subset is not None:
            values = {f.name: getattr(subset, f.name) for f in fields(subset)}
            out["subset"] = {k: v for k, v in values.items() if v is not None}
        if self.stop is not None:
            out["stop"] = {"metric": self.stop.metric, "width": self.stop.width}
        return out

    def to_toml(self) -> str:
        """Return the campaign specification as TOML text."""
        return tomli_w.dumps(self.to_dict())

    def with_settings(self, **values: Any) -> CampaignSpec:
        """Return the campaign with some top-level keys changed.

        `values` must not change the number of flights or the seed, because the random values depend
        on them.
        """
        return replace(self, head=replace(self.head, **values))


_TABLES = (
    "scenario", "factors", "arms", "dispersions", "correlations", "importance", "subset", "stop",
)  # fmt: skip
# Tables whose values may name files.
_WITH_PATHS = ("factors", "arms", "dispersions")


def _resolve_paths(tables: Any, folder: Path, *, is_path: bool = False) -> Any:
    """Return nested tables in which relative paths are replaced by absolute ones.

    Relative paths start from `folder`. `is_path` states whether `tables` is the value of a key that
    names a file.
    """
    if isinstance(tables, Mapping):
        return {
            key: _resolve_paths(
                value, folder, is_path=(is_path and key == "values") or _names_file(str(key))
            )
            for key, value in tables.items()
        }
    if isinstance(tables, list):
        return [_resolve_paths(value, folder, is_path=is_path) for value in tables]
    return str((folder / tables).resolve()) if is_path and isinstance(tables, str) else tables


def _names_file(key: str) -> bool:
    last = key.rpartition(".")[2]
    return last == "path" or last.endswith("_path")


def _arms(
    scenario: Scenario, factors: Any, arms: Any
) -> tuple[dict[str, list[Any]], tuple[Arm, ...]]:
    if factors is not None and arms is not None:
        given = len(arms) if isinstance(arms, list) else arms
        raise InputError(
            "arms", given, "must not be combined with [factors]",
            "Delete one of the two.", show_value=False,
        )  # fmt: skip
    if arms is not None:
        return {}, build_arms(scenario, parse_arms(arms), "arms")
    levels = flatten_keys(factors or {}, "factors", list)
    return levels, build_arms(scenario, product(levels), "factors")


def _scenario(given: Any, folder: Path | None) -> Scenario:
    if isinstance(given, Mapping):
        return Scenario.from_dict(given, folder)
    if not isinstance(given, str):
        raise InputError("scenario", given, "must be the path or name of a scenario, or its tables")
    return Scenario.load(shipped.found(Path(given), folder))


def _head(table: Mapping[str, Any]) -> CampaignSettings:
    """Build the settings of a campaign from the top-level keys of its file."""
    try:
        head: CampaignSettings = build_settings("", CampaignSettings, table)
    except InputError as error:
        key = error.field.removeprefix(".")
        if "unknown key" not in error.problem:
            raise error.with_field(key) from None
        hint = suggestion(key, [*settings_of(CampaignSettings).model_fields, *_TABLES])
        problem = "is an unknown key at the top level of the campaign"
        raise InputError(key, error.value, problem, hint, False) from None
    return head


def _keys(head: CampaignSettings) -> dict[str, Any]:
    suffix = {"time_limit": "_s", "time_budget": "_s"}
    return {f.name + suffix.get(f.name, ""): getattr(head, f.name) for f in fields(head)}


def _arm_values(arm: Arm) -> dict[str, Any]:
    """Return the scenario values that an arm sets, with the `repr` of a policy object.

    An arm is a variant of the scenario.
    """
    values: dict[str, Any] = _plain(arm.values)
    return values if arm.policy is None else values | {"policy object": repr(arm.policy)}


def _distribution_table(law: Any) -> dict[str, Any]:
    kind = next(name for name, of in KINDS.items() if of is type(law))
    values = {f.name: getattr(law, f.name) for f in fields(law)}
    return {"kind": kind} | {k: _plain(v) for k, v in values.items() if v is not None}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
