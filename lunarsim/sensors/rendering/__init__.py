"""Rendering of terrain through OpenGL: radiance, range, normal and identity of every pixel."""

from lunarsim.sensors.rendering.renderer import Image, Renderer, View, renderer_of

__all__ = ["Image", "Renderer", "View", "renderer_of"]
