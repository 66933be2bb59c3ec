"""Images of a world: the map by OpenGL, and the terrain beyond it by ray casting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.pinhole import View
from lunarsim.sensors.rendered_image import RenderedImage
from lunarsim.sensors.rendering.renderer import renderer_of
from lunarsim.typing import Array
from lunarsim.world import World
from lunarsim.world.far_shadow import FarShadow

# Tolerance for the order of hits on the map and beyond it: a share of the range, and m.
_ORDER_TOLERANCE = (1e-3, 0.5)
# Rays to the Sun start this far above the terrain, m.
_RAY_OFFSET_M = 0.1
# Elevation of a Sun that lights nothing, rad.
_NIGHT = -0.5 * np.pi


def render_world(world: World, view: View, *, truth: bool = False) -> RenderedImage:
    """Render an image of a world with the terrain beyond the map.

    Without far terrain, this is the image of the renderer of the map. Otherwise the map is drawn at
    its finest level. Terrain beyond the map dims the direct sunlight on the map, but not the light
    that the map scatters. The Sun is a point for the shadows beyond the map.

    Parameters
    ----------
    world, view
        World, and pose, projection and size of the image.
    truth
        Whether to return range, normal and identity; terrain beyond the map has the identity -1.

    Raises
    ------
    InputError
        If the camera is below the terrain or its pose is not valid.
    """
    renderer = renderer_of(world.terrain)
    if world.far_terrain is None:
        return renderer.render(view, world.light, truth=truth)
    image = renderer.render(view, world.light, truth=True)
    rays = view.rays()
    radiance = _with_far_shadows(world, view, image, rays)
    drawn = _with_far_terrain(world, view, replace(image, radiance=radiance), rays)
    return drawn if truth else RenderedImage(drawn.radiance)


def _with_far_shadows(
    world: World, view: View, image: RenderedImage, rays: Array
) -> NDArray[np.float32]:
    """Return the radiance (height, width) with shadows of the far terrain on the map."""
    assert image.range is not None
    assert image.identity is not None
    assert world.far_terrain is not None
    on_map = image.identity >= -1
    if world.light.elevation <= 0.0 or not on_map.any():
        return image.radiance
    points = view.position + image.range[on_map][:, None].astype(np.float64) * rays[on_map]
    lit = FarShadow.of(world.far_terrain, world.light).sunlight(points)
    if lit.min() >= 1.0:
        return image.radiance
    night = replace(world.light, elevation=_NIGHT)
    dark = renderer_of(world.terrain).render(view, night, truth=True).radiance[on_map]
    out = image.radiance.copy()
    out[on_map] = dark + lit.astype(np.float32) * (out[on_map] - dark)
    return out


def _with_far_terrain(world: World, view: View, image: RenderedImage, rays: Array) -> RenderedImage:
    """Add the terrain beyond the map to an image, in the sky and before the map."""
    far = world.far_terrain
    assert far is not None
    assert image.range is not None
    assert image.normal is not None
    assert image.identity is not None
    west, east, south, north = world.terrain.bounds
    x, y = view.position[:2]
    is_over_map = west <= x <= east and south <= y <= north
    cast = image.identity == -2 if is_over_map else np.ones(image.identity.shape, np.bool_)
    hits = far.cast(view.position, rays[cast])
    share, offset = _ORDER_TOLERANCE
    near = image.range[cast] * (1.0 - share) - offset
    seen = np.isfinite(hits.range) & ~(hits.range >= near)
    at = np.flatnonzero(cast)[seen]
    if not at.size:
        return image
    radiance, range_ = image.radiance.flatten(), image.range.flatten()
    identity, normal = image.identity.flatten(), image.normal.reshape(-1, 3).copy()
    ray = rays.reshape(-1, 3)[at]
    range_[at], normal[at], identity[at] = hits.range[seen], hits.normal[seen], -1
    points = view.position + hits.range[seen][:, None] * ray
    radiance[at] = _far_radiance(world, points, hits.normal[seen], -ray)
    shape = image.range.shape
    return RenderedImage(
        radiance.reshape(shape), range_.reshape(shape), normal.reshape(*shape, 3),
        identity.reshape(shape),
    )  # fmt: skip


def _far_radiance(world: World, points: Array, normals: Array, to_camera: Array) -> Array:
    """Return the radiance factor (n,) of points (n, 3) of the terrain beyond the map.

    `normals` and `to_camera` (n, 3) are unit vectors.
    """
    light, far = world.light, world.far_terrain
    assert far is not None
    out = np.full(len(points), light.albedo * light.ambient)
    for source, irradiance in ((light.direction, 1.0), (light.earth, light.earthshine)):
        mu0 = normals @ source
        lit = np.flatnonzero(mu0 > 0.0) if irradiance > 0.0 else np.zeros(0, int)
        start = points[lit] + _RAY_OFFSET_M * normals[lit]
        blocked = far.cast(start, np.broadcast_to(source, (len(lit), 3))).range
        lit = lit[np.isnan(blocked)]
        mu = np.einsum("ij,ij->i", normals[lit], to_camera[lit])
        out[lit] += irradiance * light.radiance_factor(mu0[lit], mu, to_camera[lit] @ source)
    return out
