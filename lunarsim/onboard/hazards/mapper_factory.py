"""Construction of the mappers of one flight from its briefing."""

from __future__ import annotations

from typing import Any

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.error_prefix import prefix_input_errors
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.navigation.estimate import Navigation


def build_mappers(briefing: Briefing, navigation: Navigation) -> dict[str, HazardMapper]:
    """Return the mappers by name, in the order of the briefing.

    Mappers that use other mappers are built after them.

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
    """Return the build stage: 0 without dependencies, 1 with `ground`, 2 with `of`."""
    if hasattr(part, "of"):
        return 2
    return 1 if getattr(part, "ground", "") else 0
