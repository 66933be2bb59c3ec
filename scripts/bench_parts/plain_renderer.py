"""Render terrain with a simple OpenGL renderer, as a reference for speed.

The relief is one mesh of all its triangles and every rock an instance of a cube. Shadows come from
one map of 2048 x 2048 texels with linear depth, and every drawn fragment is shaded.
"""

from __future__ import annotations

import moderngl
import numpy as np

from lunarsim.sensors.rendering.context import gl_context, on_render_thread

_PLACE = """
uniform mat4 camera;
uniform mat4 to_map;
out vec3 at;
out vec4 in_map;
void put(vec3 p) { at = p; in_map = to_map * vec4(p, 1.0); gl_Position = camera * vec4(p, 1.0); }
"""
_RELIEF = "#version 330\n" + _PLACE + "in vec3 post;\nvoid main() { put(post); }"
_ROCK = (
    "#version 330\n"
    + _PLACE
    + """
in vec3 corner;
in vec4 rock;    // centre of the base, half side
in vec3 more;    // half side, height, yaw
void main() {
    vec2 c = vec2(cos(more.z), sin(more.z)), s = corner.xy * vec2(rock.w, more.x);
    vec2 turned = vec2(c.x * s.x - c.y * s.y, c.y * s.x + c.x * s.y);
    put(rock.xyz + vec3(turned, corner.z * more.y));
}
"""
)
_SHADE = """
#version 330
in vec3 at;
in vec4 in_map;
uniform sampler2D shadow;
uniform vec3 sun;
out float grey;
void main() {
    vec3 n = normalize(cross(dFdx(at), dFdy(at)));
    vec3 m = 0.5 * in_map.xyz + 0.5;
    float lit = texture(shadow, m.xy).r + 2e-3 < m.z ? 0.0 : 1.0;
    grey = 0.12 * max(abs(n.z) > 0.0 ? dot(n * sign(n.z), sun) : 0.0, 0.0) * lit;
}
"""
_DEPTH = "#version 330\nvoid main() {}"


class PlainRenderer:
    """Simple renderer of one terrain, with relief, cube rocks and a shadow map.

    Parameters
    ----------
    terrain
        Relief and rocks; every rock is drawn as a cube.
    """

    @on_render_thread
    def __init__(self, terrain):
        self._ctx = ctx = gl_context()
        g = terrain.relief.grid
        xx, yy = np.meshgrid(g.x, g.y)
        posts = np.stack((xx, yy, terrain.relief.z), -1).astype("f4")
        a = (np.arange(g.rows - 1)[:, None] * g.cols + np.arange(g.cols - 1)).ravel()
        around = (a, a + 1, a + g.cols + 1, a, a + g.cols + 1, a + g.cols)
        index = ctx.buffer(np.stack(around, 1).astype("i4").tobytes())
        unit = np.array([(x, y, z) for z in (0, 1) for y in (-1, 1) for x in (-1, 1)], "f4")
        sides = [0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5, 4, 5, 7,
                 4, 7, 6]  # fmt: skip
        rows = terrain.rocks.rows()
        yaw = np.arctan2(rows[:, 7], rows[:, 6])
        rocks = np.column_stack((rows[:, :6], yaw)).astype("f4")
        corners, order = ctx.buffer(unit.tobytes()), ctx.buffer(np.array(sides, "i4").tobytes())
        relief, stones = ctx.buffer(posts.tobytes()), ctx.buffer(rocks.tobytes())
        self._count = len(rows)
        self._passes = []
        for fragment in (_DEPTH, _SHADE.strip()):
            surface = ctx.program(vertex_shader=_RELIEF, fragment_shader=fragment)
            rock = ctx.program(vertex_shader=_ROCK, fragment_shader=fragment)
            self._passes.append((
                (surface, ctx.vertex_array(surface, [(relief, "3f", "post")], index), 1),
                (rock, ctx.vertex_array(
                    rock, [(corners, "3f", "corner"), (stones, "4f 3f/i", "rock", "more")], order
                ), self._count),
            ))  # fmt: skip
        self._map = ctx.depth_texture((2048, 2048))
        self._map.compare_func = ""
        self._shadow = ctx.framebuffer(depth_attachment=self._map)
        self._grey = ctx.texture((640, 480), 1, dtype="f4")
        self._picture = ctx.framebuffer([self._grey], ctx.depth_texture((640, 480)))

    @on_render_thread
    def render(self, view, sun):
        """Render the image (480, 640) of a camera pose; `sun` (3,) is towards the Sun."""
        a = view.axes.T
        near, far = 1.0, 4.0 * float(view.position[2])
        camera = np.zeros((4, 4))
        camera[0, :3] = 2.0 * view.fx / view.width * a[0]
        camera[1, :3] = 2.0 * view.fy / view.height * a[1]
        camera[2, :3] = (far + near) / (far - near) * a[2]
        camera[3, :3] = a[2]
        camera[:, 3] = -camera[:, :3] @ view.position
        camera[2, 3] -= 2.0 * far * near / (far - near)
        side = np.cross([0.0, 0.0, 1.0], sun)
        side /= np.linalg.norm(side)
        reach = 0.8 * float(view.position[2]) + 20.0
        to_map = np.eye(4)
        to_map[:3, :3] = np.stack((side, np.cross(sun, side), -sun)) / reach
        target = np.array([view.position[0], view.position[1], 0.0])
        to_map[:3, 3] = -to_map[:3, :3] @ target
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        self._map.use(0)
        for buffer, drawn, matrix in zip(
            (self._shadow, self._picture), self._passes, (to_map, camera), strict=True
        ):
            buffer.use()
            buffer.clear(depth=1.0)
            for program, vao, instances in drawn:
                values = {"camera": matrix.T, "to_map": to_map.T, "sun": sun}
                for name, value in values.items():
                    if name in program:
                        program[name].write(np.ascontiguousarray(value, "f4").tobytes())
                vao.render(instances=instances)
        return np.frombuffer(self._grey.read(), "f4").reshape(480, 640)
