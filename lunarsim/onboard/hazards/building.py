"""From a briefing to the mappers of one flight."""

from __future__ import annotations

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.named_errors import named_in
from lunarsim.onboard.navigation.estimate import Navigation


def built_mappers(briefing: Briefing, navigation: Navigation) -> dict[str, HazardMapper]:
    """Return the mappers by name, in the briefing's order; those made of others are built last.

    Raises
    ------
    InputError
        Naming the mapper that cannot be built.
    """
    parts, built = briefing.software.mappers, dict[str, HazardMapper]()
    for name, part in sorted(parts.items(), key=lambda item: hasattr(item[1], "of")):
        others = (built,) if hasattr(part, "of") else ()
        with named_in(f"mappers.{name}"):
            built[name] = part.build(briefing, navigation, *others)
    return {name: built[name] for name in parts}
