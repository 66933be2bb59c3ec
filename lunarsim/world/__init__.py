"""What is true: the ground, the light on it, gravity; truth as maps; surveys made of it."""

from lunarsim.world.light import Light
from lunarsim.world.world import World

__all__ = ["Light", "World"]
