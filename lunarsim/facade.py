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
    """Return a scenario from a name, from a file, or unchanged if it is a `Scenario`.

    Parameters
    ----------
    scenario
        Name of a scenario supplied with lunarsim (`lunarsim scenario list`), path of a TOML file,
        or a `Scenario`.

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
    """Simulate one descent of a scenario and return the flight record.

    ``fly(name, seed=1)`` is the flight of ``lunarsim fly name --seed 1``, bit by bit.

    Parameters
    ----------
    scenario
        Name of a scenario of the package, path of a TOML file, or a scenario.
    policy
        Retargeting policy: a name of `lunarsim parts policy`, "module:Class" or an object; None:
        the policy of the scenario.
    guidance
        Guidance law: a name of `lunarsim parts guidance` or "module:Class"; None: the law of the
        scenario.
    seed, flight
        Root seed and index of the flight: terrain, start and noise derive from them.
    changes
        Values that replace values in the scenario's tables: ``rocks={"cover": 0.08}``.

    Raises
    ------
    InputError
        If the scenario, a change, the policy or the guidance law is invalid.

    Examples
    --------
    >>> import lunarsim
    >>> flight = lunarsim.fly("hirise", policy="safest", seed=1, rocks={"cover": 0.02})
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
    """Fly several policies or guidance laws on identical flights; return the results.

    All policies and laws fly the same terrain, start states and noise.

    Parameters
    ----------
    scenario
        Name of a scenario of the package, path of a TOML file, or a scenario.
    policies
        Retargeting policies: names, "module:Class", or objects (picklable if `jobs` is above 1).
    flights, seed, jobs
        Number of flights of each policy, root seed, and number of processes; results do not depend
        on `jobs`.
    guidance
        Guidance laws, each flown under every policy; empty: the law of the scenario.
    out
        Folder for results, flight records and figures; None: no files are written.

    Raises
    ------
    InputError
        If an argument or the scenario is invalid.

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
    """Render an image of a scenario's target area with its first camera.

    Parameters
    ----------
    scenario
        Name of a scenario of the package, path of a TOML file, or a scenario.
    options
        ``altitude``: height of the camera above the terrain at the target, m, 100 by default;
        ``sun_elevation_deg`` and ``sun_azimuth_deg``: direction of the Sun, by default the
        scenario's; ``off_nadir_deg`` and ``heading_deg``: angle of the boresight from nadir, and
        azimuth of the top of the image; ``exposure``: exposure time, s, by default automatic;
        ``ideal=True``: no blur, noise and distortion; ``truth=True``: keep radiance, range, normal
        and identity of every pixel; ``seed`` and ``flight``: flight whose world is rendered.

    Raises
    ------
    InputError
        If the scenario or an option is invalid.
    RenderingError
        If OpenGL is missing; the message names the package to install.

    Examples
    --------
    >>> import lunarsim
    >>> lunarsim.render("hirise", altitude=60.0).counts.shape
    (480, 640)
    """
    return render_scenario(load_scenario(scenario), **options)
