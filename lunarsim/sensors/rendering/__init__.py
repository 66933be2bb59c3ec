"""Rendering of terrain through OpenGL: radiance, range, normal and identity of every pixel."""

from lunarsim.sensors.rendering.renderer import Renderer, renderer_of
from lunarsim.sensors.rendering.view import Image, View

__all__ = ["Image", "Renderer", "View", "renderer_of"]
