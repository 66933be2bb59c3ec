"""Registry of the scenario components ("parts") of every category ("contract").

A new part takes one file and one line here. Another package can add a name by an entry point of the
group ``lunarsim.CONTRACT``, or a scenario can give ``kind = "module:Class"`` if the user allows the
module (`lunarsim.parts.module_permission`).
"""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from lunarsim.errors import InputError, suggestion
from lunarsim.parts.module_permission import check_allowed


@dataclass(frozen=True)
class Contract:
    """Category of exchangeable components ("parts") that share an interface.

    Attributes
    ----------
    summary
        Purpose of the components, in a few words.
    kinds
        Mapping from registered name to "module:Class", for the components in lunarsim.
    required_members
        Names of the attributes and methods that every component must have.
    """

    summary: str
    kinds: dict[str, str]
    required_members: tuple[str, ...]


# Kinds that need a file and have no usable defaults: external software, and guidance along a given
# trajectory.
FILE_KINDS = ("library", "fmu", "process", "trajectory")
# Field names that the settings tables use themselves.
RESERVED = {"kind", "make", "model_config", "copy", "json", "dict"}

CONTRACTS: dict[str, Contract] = {
    "terrain": Contract(
        "terrain",
        {
            "fractal": "lunarsim.world.terrain_models.fractal:FractalTerrain",
            "dtm": "lunarsim.world.terrain_models.measured:RasterTerrain",
            "hazard-field": "lunarsim.world.terrain_models.hazard_field:HazardFieldTerrain",
        },
        ("build",),
    ),
    "vehicle": Contract(
        "lander",
        {
            "lander": "lunarsim.models.lander:Lander",
            "jet-lander": "lunarsim.models.jet_lander:JetLander",
        },
        ("pads", "wet_mass", "check_hover"),
    ),
    "sensor": Contract(
        "sensor",
        {
            "imu": "lunarsim.sensors.imu:ImuSettings",
            "navigation-fix": "lunarsim.sensors.navigation_fix:NavigationFixErrors",
            "radar-altimeter": "lunarsim.sensors.altimeter:RadarAltimeter",
            "velocimeter": "lunarsim.sensors.velocimeter:DopplerVelocimeter",
            "star-tracker": "lunarsim.sensors.star_tracker:StarTracker",
            "flash-lidar": "lunarsim.sensors.lidar:FlashLidar",
            "camera": "lunarsim.sensors.framing_camera:FramingCamera",
        },
        ("measurement_type", "is_tasked", "calibration"),
    ),
    "sensor-fault": Contract(
        "fault of a sensor",
        {
            "bias": "lunarsim.sensors.faults:BiasFault",
            "drift": "lunarsim.sensors.faults:DriftFault",
            "noise": "lunarsim.sensors.faults:NoiseFault",
            "dropout": "lunarsim.sensors.faults:DropoutFault",
            "frozen": "lunarsim.sensors.faults:FrozenFault",
            "latency": "lunarsim.sensors.faults:LatencyFault",
            "range-gate": "lunarsim.sensors.faults:RangeGateFault",
        },
        ("is_active", "applies_to", "apply"),
    ),
    "tasking": Contract(
        "pointing and timing of a sensor's measurements",
        {
            "at-altitudes": "lunarsim.onboard.tasking.schedules:AtAltitudes",
            "periodic": "lunarsim.onboard.tasking.schedules:Periodic",
            "sweep": "lunarsim.onboard.tasking.schedules:Sweep",
        },
        ("build",),
    ),
    "navigation": Contract(
        "state estimation",
        {
            "inertial": "lunarsim.onboard.navigation.navigation_kinds:InertialNavigation",
            "fixes": "lunarsim.onboard.navigation.navigation_kinds:ExternalFixes",
            "rocks": "lunarsim.onboard.navigation.navigation_kinds:RockNavigation",
            "prior-map": "lunarsim.onboard.navigation.navigation_kinds:PriorMapNavigation",
            "ukf": "lunarsim.onboard.navigation.unscented:UnscentedNavigation",
        },
        ("build", "needs", "accepts", "needs_prior_map", "uses_prior_map"),
    ),
    "mapper": Contract(
        "hazard map of the landing area",
        {
            "gaussian-dem": (
                "lunarsim.onboard.hazards.gaussian_dem.mapper:GaussianDemMapperSettings"
            ),
            "shadow": "lunarsim.onboard.hazards.shadows.mapping:ShadowMapping",
            "quadtree": "lunarsim.onboard.hazards.quadtree.mapper:QuadtreeMapperSettings",
            "fused": "lunarsim.onboard.hazards.fusion.mapper:FusedMapperSettings",
            "library": "lunarsim.onboard.external.mapper:LibraryMapper",
            "process": "lunarsim.onboard.external.mapper:ProcessMapper",
        },
        ("build", "accepts", "sensor"),
    ),
    "policy": Contract(
        "selection of the landing site",
        {
            "no-divert": "lunarsim.onboard.policies.library:NoDivert",
            "safest": "lunarsim.onboard.policies.library:Safest",
            "safest-or-abort": "lunarsim.onboard.policies.library:SafestOrAbort",
            "nearest-safe": "lunarsim.onboard.policies.library:NearestSafe",
            "fuel-aware": "lunarsim.onboard.policies.library:FuelAware",
            "scoreboard": "lunarsim.onboard.policies.library:ScoreboardChoice",
            "truth-oracle": "lunarsim.simulation.oracle:TruthOracle",
            "library": "lunarsim.onboard.external.policy:LibraryPolicy",
            "process": "lunarsim.onboard.external.policy:ProcessPolicy",
        },
        ("decide", "name"),
    ),
    "guidance": Contract(
        "guidance law of the approach",
        {
            "apollo": "lunarsim.onboard.guidance.apollo:ApolloLaw",
            "modified-apollo": "lunarsim.onboard.guidance.polynomial_laws:ModifiedApolloLaw",
            "e-guidance": "lunarsim.onboard.guidance.polynomial_laws:EGuidanceLaw",
            "zem-zev": "lunarsim.onboard.guidance.polynomial_laws:ZemZevLaw",
            "augmented-apollo": "lunarsim.onboard.guidance.polynomial_laws:AugmentedApolloLaw",
            "fractional-polynomial": (
                "lunarsim.onboard.guidance.polynomial_laws:FractionalPolynomialLaw"
            ),
            "optimal": "lunarsim.onboard.guidance.optimal_law:OptimalLaw",
            "neural-optimal": "lunarsim.onboard.guidance.neural_law:NeuralOptimalLaw",
            "information-seeking": (
                "lunarsim.onboard.active_perception.guidance:InformationSeekingLaw"
            ),
            "trajectory": "lunarsim.onboard.guidance.trajectory_law:TrajectoryLaw",
            "library": "lunarsim.onboard.external.guidance:LibraryGuidance",
            "fmu": "lunarsim.onboard.external.guidance:LibraryGuidance",
            "process": "lunarsim.onboard.external.guidance:ProcessGuidance",
        },
        ("build", "cost"),
    ),
    "computer": Contract(
        "complete onboard computer",
        {
            "library": "lunarsim.onboard.external.computer:LibraryComputer",
            "process": "lunarsim.onboard.external.computer:ProcessComputer",
        },
        ("build",),
    ),
    "terminal-descent": Contract(
        "guidance law of the terminal descent",
        {
            "vertical": "lunarsim.onboard.guidance.vertical:VerticalDescent",
            "rate-of-descent": "lunarsim.onboard.guidance.rate_of_descent:RateOfDescent",
            "gravity-turn": "lunarsim.onboard.guidance.gravity_turn:GravityTurn",
            "velocity-null": "lunarsim.onboard.guidance.velocity_null:VelocityNull",
            "library": "lunarsim.onboard.external.guidance:LibraryTerminalDescent",
            "process": "lunarsim.onboard.external.guidance:ProcessTerminalDescent",
        },
        ("build",),
    ),
    "control": Contract(
        "attitude control",
        {
            "pd": "lunarsim.onboard.control.attitude:ProportionalDerivative",
            "ideal": "lunarsim.onboard.control.attitude:IdealAttitude",
            "quaternion-feedback": (
                "lunarsim.onboard.control.quaternion_feedback:QuaternionFeedback"
            ),
            "phase-plane": "lunarsim.onboard.control.phase_plane:PhasePlane",
            "library": "lunarsim.onboard.external.control:LibraryControl",
            "fmu": "lunarsim.onboard.external.control:LibraryControl",
            "process": "lunarsim.onboard.external.control:ProcessControl",
        },
        ("torques", "torque", "response_time"),
    ),
}


def kinds(contract: str, *, with_files: bool = True) -> dict[str, str]:
    """Return the registered components of a category: name to "module:Class".

    `contract` is a key of `CONTRACTS`, such as "policy". Components of other installed packages
    are included. `with_files` states whether kinds that need a file are included, such as external
    software.

    Raises
    ------
    InputError
        If two packages register the same name.

    Examples
    --------
    >>> "safest" in kinds("policy")
    True
    """
    found = dict(CONTRACTS[contract].kinds)
    for point in installed_parts(f"lunarsim.{contract}", tuple(sys.path)):
        if point.name in found and found[point.name] != point.value:
            raise InputError(
                f"entry point lunarsim.{contract}",
                point.name,
                "must have a unique name",
                f"Give {point.value} another entry-point name: {found[point.name]} has this one.",
            )
        found[point.name] = point.value
    return found if with_files else {k: v for k, v in found.items() if k not in FILE_KINDS}


@cache
def installed_parts(group: str, search_path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group in all installed packages.

    `group` is a name such as "lunarsim.policy"; `search_path` is Python's module path. The result
    is cached, because a scan of all installed packages takes 10 ms and each component of a scenario
    needs the entry points.
    """
    return tuple(_entry_points(search_path).select(group=group))


@cache
def _entry_points(search_path: tuple[str, ...]) -> Any:
    return entry_points()


def loadable_parts(contract: str) -> Iterator[tuple[str, Any]]:
    """Yield registered name and class of each component of a category.

    Components that cannot be loaded are omitted. `contract` is a key of `CONTRACTS`.
    """
    for kind in kinds(contract):
        try:
            yield kind, resolve(contract, kind)
        except InputError:
            continue  # `lunarsim parts` reports the reason


def resolve(contract: str, kind: str, field: str | None = None) -> type:
    """Load the class of a component from its registered name or "module:Class".

    Parameters
    ----------
    contract
        Key of `CONTRACTS`.
    kind
        Registered name, or "module:Class".
    field
        Scenario key that contains `kind`, for error messages.

    Raises
    ------
    InputError
        If the component does not exist, cannot be imported, or its module is not allowed.

    Examples
    --------
    >>> resolve("policy", "safest").__name__
    'Safest'
    """
    field = field or f"{contract}.kind"
    module, colon, _ = kind.partition(":")
    # Finding entry points scans all installed packages (10 ms): only if needed.
    if colon and kind not in kinds(contract).values():
        check_allowed(field, kind, module)
    # A session may define a class of __main__ again, under the same name.
    found = _resolve.__wrapped__ if module == "__main__" else _resolve
    return found(contract, kind, field)


# Remedy for a class or function that cannot be imported.
IMPORT_REMEDY = "Check the name; the module must be installed or in the working directory."


def import_part_module(module: str) -> ModuleType:
    """Import a module by name; the working directory is searched last.

    An installed command, unlike ``python -m``, does not search the working directory.
    """
    here, first = Path.cwd(), module.partition(".")[0]
    beside = (here / f"{first}.py").is_file() or (here / first / "__init__.py").is_file()
    if beside and str(here) not in sys.path and importlib.util.find_spec(first) is None:
        sys.path.append(str(here))
    return importlib.import_module(module)


@cache
def _resolve(contract: str, kind: str, field: str) -> type:
    known = kinds(contract)
    where = kind if ":" in kind else known.get(kind)
    if where is None:
        raise InputError(
            field,
            kind,
            'must be a known name, or a class as "module:Class"',
            suggestion(kind, known),
        )
    module, _, name = where.partition(":")
    try:
        found = getattr(import_part_module(module), name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a custom module can raise anything, including SystemExit
        message = str(error).split("\n")[0]
        is_missing = isinstance(error, ImportError | AttributeError)
        remedy = IMPORT_REMEDY if is_missing else "Correct this error in the module."
        raise InputError(
            field, kind,
            "must name a class that can be imported",
            f"Python reports {type(error).__name__}: {message}. {remedy}",
        ) from error  # fmt: skip
    if not (isinstance(found, type) and dataclasses.is_dataclass(found)):
        raise InputError(
            field, where, "must name a dataclass", "Decorate it with @dataclass(frozen=True)."
        )
    if not found.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        raise InputError(
            field,
            where,
            "must name a frozen dataclass",
            "Decorate it with @dataclass(frozen=True).",
        )
    names = {f.name for f in dataclasses.fields(found)}
    missing = [
        n for n in CONTRACTS[contract].required_members if n not in names and not hasattr(found, n)
    ]
    if missing:
        raise InputError(
            field,
            where,
            f"must name a class that defines {missing[0]!r}, as every {contract} component must",
        )
    reserved = names & RESERVED
    if reserved:
        raise InputError(
            field,
            where,
            f"must name a class without a field {min(reserved)!r}, which is a reserved name",
            "Rename the field.",
        )
    return found
