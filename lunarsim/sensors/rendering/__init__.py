"""OpenGL rendering of radiance, range, normal and identity of every pixel."""

from lunarsim.sensors.rendered_image import RenderedImage
from lunarsim.sensors.rendering.renderer import Renderer, renderer_of

__all__ = ["RenderedImage", "Renderer", "renderer_of"]
