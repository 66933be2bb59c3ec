"""OpenGL rendering of radiance, range, normal and identity of every pixel."""

from lunarsim.sensors.rendered_image import RenderedImage
from lunarsim.sensors.rendering.renderer import Renderer, renderer_of
from lunarsim.sensors.rendering.world_image import render_world

__all__ = ["RenderedImage", "Renderer", "render_world", "renderer_of"]
