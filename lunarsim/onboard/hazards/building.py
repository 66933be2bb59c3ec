"""From a briefing to the mappers of one flight."""

from __future__ import annotations

from typing import Any

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.named_errors import named_in
from lunarsim.onboard.navigation.estimate import Navigation


def built_mappers(briefing: Briefing, navigation: Navigation) -> dict[str, HazardMapper]:
    """Return the mappers by name, in the briefing's order; who asks another is built after it.

    Raises
    ------
    InputError
        Naming the mapper that cannot be built.
    """
    parts, built = briefing.software.mappers, dict[str, HazardMapper]()
    for name, part in sorted(parts.items(), key=lambda item: _place(item[1])):
        others = (built,) if _place(part) else ()
        with named_in(f"mappers.{name}"):
            built[name] = part.build(briefing, navigation, *others)
    return {name: built[name] for name in parts}


def _place(part: Any) -> int:
    """Return when a mapper is built: 0, or after those whose ground or whose maps it asks for."""
    if hasattr(part, "of"):
        return 2
    return 1 if getattr(part, "ground", "") else 0
