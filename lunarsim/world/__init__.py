"""True environment: terrain, illumination, gravity, truth maps and prior surveys."""

from lunarsim.world.light import Light
from lunarsim.world.world import World

__all__ = ["Light", "World"]
