"""Simulate lunar landings: terrain, sensing, hazard maps, retargeting, guidance.

    import lunarsim

    flight = lunarsim.fly("hirise", policy="safest", seed=1)
    print(flight)

docs/reference/api.md lists all public names; `lunarsim.api` has the contracts for custom parts.
"""

from __future__ import annotations

__version__ = "0.2.0"

from lunarsim._lazy import lazy_names
from lunarsim.forks import watch_forks
from lunarsim.user_cache import ensure_caches

ensure_caches()
watch_forks()

# Module of each public name, imported at first use; `__init__.pyi` has them for type checkers.
_MODULES = {
    "CompareResult": "lunarsim.campaign.comparison",
    "InputError": "lunarsim.errors",
    "RenderingError": "lunarsim.errors",
    "map_quality": "lunarsim.evaluation.map_quality",
    "rebuild_world": "lunarsim.simulation.worlds",
    "compare": "lunarsim.facade",
    "fly": "lunarsim.facade",
    "load_scenario": "lunarsim.facade",
    "render": "lunarsim.facade",
    "Grid": "lunarsim.grid",
    "gaussian_dem": "lunarsim.onboard.hazards.gaussian_dem",
    "HazardMap": "lunarsim.onboard.hazards.hazard_map",
    "allow_modules": "lunarsim.parts.module_permission",
    "RandomStreams": "lunarsim.rng",
    "flight_seed": "lunarsim.rng",
    "exact_safety": "lunarsim.safety",
    "Scenario": "lunarsim.scenario.scenario",
    "Flight": "lunarsim.simulation.flight",
    "Simulation": "lunarsim.simulation.loop",
    "build_world": "lunarsim.simulation.worlds",
    "FlightFigures": "lunarsim.viz.flight",
    "plot_flight": "lunarsim.viz.flight",
    "site_safety": "lunarsim.world.site_safety",
    "load_terrain": "lunarsim.world.terrain.dtm",
    "Heightfield": "lunarsim.world.terrain.heightfield",
    "Terrain": "lunarsim.world.terrain.terrain",
}
__all__ = sorted(_MODULES)  # noqa: PLE0605
__getattr__, __dir__ = lazy_names(__name__, _MODULES, globals())
