"""Functions of `import lunarsim` that join several packages: fly, compare, render."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from lunarsim.campaign.comparison import CompareResult
from lunarsim.campaign.comparison import compare as compare_scenario
from lunarsim.onboard.policies.contract import RetargetingPolicy
from lunarsim.parts.module_permission import find_module_names, modules_allowed
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.scenario.scenario_warnings import warnings_for
from lunarsim.scenario.shipped import found
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.image_rendering import SceneImage
from lunarsim.simulation.image_rendering import render as render_scenario
from lunarsim.simulation.loop import Simulation

if TYPE_CHECKING:
    from lunarsim.scenario.tables import FlightChanges

POLICIES = ("no-divert", "safest", "nearest-safe", "fuel-aware", "truth-oracle")


def load_scenario(scenario: Scenario | str | Path) -> Scenario:
    """Return a scenario given by name, by file or as it is.

    Parameters
    ----------
    scenario
        Name of a scenario of the package (`scenario_names`), path of a TOML file, or a scenario.

    Raises
    ------
    InputError
        If there is no such scenario, or the file has an error.

    Examples
    --------
    >>> import lunarsim
    >>> lunarsim.load_scenario("hirise").name
    'hirise'
    """
    return scenario if isinstance(scenario, Scenario) else Scenario.load(found(Path(scenario)))


def fly(
    scenario: Scenario | str | Path = "hirise",
    *,
    policy: RetargetingPolicy | str | None = None,
    guidance: str | None = None,
    seed: int = 1,
    flight: int = 0,
    **changes: Unpack[FlightChanges],
) -> Flight:
    """Fly one descent and return its record.

    ``fly(name, seed=1)`` is the flight of ``lunarsim fly name --seed 1``, bit by bit.

    Parameters
    ----------
    scenario
        Name of a scenario of the package, path of a TOML file, or a scenario.
    policy
        Retargeting policy: a name of `part_names("policy")`, "module:Class" or an object; None:
        the scenario's.
    guidance
        Guidance law: a name of `part_names("guidance")` or "module:Class"; None: the scenario's.
    seed, flight
        Root seed and index of the flight: terrain, start and noise derive from them.
    changes
        Other values of the scenario's tables: ``rocks={"cover": 0.08}``.

    Raises
    ------
    InputError
        If the scenario, a change or a part cannot be used.

    Examples
    --------
    >>> import lunarsim
    >>> flight = lunarsim.fly("hirise", policy="safest", seed=1, rocks={"cover": 0.08})
    >>> print(flight)  # doctest: +ELLIPSIS
    landed safely
      time of flight ...
    """
    own_parts = [text for text in (policy, guidance) if isinstance(text, str)]
    with modules_allowed(find_module_names(own_parts)):
        study = load_scenario(scenario)
        given: dict[str, Any] = dict(changes)
        if isinstance(policy, str) and policy != study.policy.kind:
            given["policy"] = {"kind": policy}
        if guidance is not None and guidance != study.guidance.kind:
            given["guidance"] = {"kind": guidance}
        study = study.changed(**given) if given else study
        for note in warnings_for(study):
            warnings.warn(note, stacklevel=2)
        chosen = study.policy.kind if policy is None else policy
        return Simulation(study, flight_seed(seed, flight), chosen).run()


def compare(
    scenario: Scenario | str | Path = "hirise",
    policies: Sequence[str | RetargetingPolicy] = POLICIES,
    *,
    flights: int = 20,
    seed: int = 1,
    jobs: int = 1,
    guidance: Sequence[str] = (),
    out: str | Path | None = None,
) -> CompareResult:
    """Fly several policies, or guidance laws, over the same worlds.

    Parameters
    ----------
    scenario
        Name of a scenario of the package, path of a TOML file, or a scenario.
    policies
        Names, "module:Class", or objects that can be pickled where `jobs` is more than 1.
    flights, seed, jobs
        Flights of each policy, root seed, and processes; results do not depend on `jobs`.
    guidance
        Guidance laws, each flown under every policy; empty: the scenario's.
    out
        Folder for results, records and figures; None: only the returned result.

    Raises
    ------
    InputError
        If the request or the scenario cannot be used.

    Examples
    --------
    >>> import lunarsim
    >>> result = lunarsim.compare("hirise", ["no-divert", "safest"], flights=1)
    >>> [row["policy"] for row in result.rows]
    ['no-divert', 'safest']
    """
    typed = [text for text in (*policies, *guidance) if isinstance(text, str)]
    with modules_allowed(find_module_names(typed)):
        return compare_scenario(
            load_scenario(scenario), policies, flights=flights, seed=seed, jobs=jobs,
            guidance=guidance, out=None if out is None else Path(out),
        )  # fmt: skip


def render(scenario: Scenario | str | Path = "hirise", **options: Any) -> SceneImage:
    """Render the target area of a scenario with its first camera.

    Parameters
    ----------
    scenario
        Name of a scenario of the package, path of a TOML file, or a scenario.
    options
        Keywords of `lunarsim.simulation.image_rendering.render`: ``altitude=60.0`` (m),
        ``sun_elevation_deg=5.0``, ``ideal=True``, ``seed=2`` and others.

    Raises
    ------
    InputError
        If a value cannot be used.
    RenderingError
        If OpenGL is missing; the message names the package to install.

    Examples
    --------
    >>> import lunarsim
    >>> lunarsim.render("hirise", altitude=60.0).counts.shape
    (480, 640)
    """
    return render_scenario(load_scenario(scenario), **options)
