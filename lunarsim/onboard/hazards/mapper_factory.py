"""Construction of the mappers of one flight from its briefing."""

from __future__ import annotations

from typing import Any

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.error_prefix import prefix_input_errors
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.navigation.estimate import Navigation


def build_mappers(briefing: Briefing, navigation: Navigation) -> dict[str, HazardMapper]:
    """Build all mappers of a flight; return them by name, in the briefing's order.

    Mappers that use other mappers are built after them. `navigation` is the navigation filter of
    the flight.

    Raises
    ------
    InputError
        If a mapper cannot be built; the error names it.
    """
    parts, mappers = briefing.software.mappers, dict[str, HazardMapper]()
    for name, part in sorted(parts.items(), key=lambda item: _build_stage(item[1])):
        others = (mappers,) if _build_stage(part) else ()
        with prefix_input_errors(f"mappers.{name}"):
            mappers[name] = part.build(briefing, navigation, *others)
    return {name: mappers[name] for name in parts}


def _build_stage(part: Any) -> int:
    """Return the build order of a mapper from its settings: 0 is built first.

    2 for a mapper that fuses others (`inputs`), 1 for a mapper that uses the elevations of another
    (`terrain_mapper`), otherwise 0.
    """
    if hasattr(part, "inputs"):
        return 2
    return 1 if getattr(part, "terrain_mapper", "") else 0
