// A rock: a scaled, rotated unit shape, as in lunarsim.rocks. Values that are constant over the rock
// are computed here and passed on as flat varyings.
in vec2 corner;    // corner of the box around the rock, relative to the image's corner, pixels
in float number;   // index of the rock (an integer)
uniform sampler2D rocks;    // three texels per rock: (x, y, base, a), (b, height, cos, sin), (shape, albedo)
#ifdef FACES
uniform vec4 planes[18 * MOST];   // half spaces of the unit shapes, MOST per shape
flat out vec4 face[FACES];
#else
flat out vec3 fixed_part;
noperspective out vec3 moving_part;
#endif
#ifdef SHADOW
flat out vec2 depth;       // depth of the base, and its increase per metre downwards
#else
flat out vec3 depth;       // window depth: x - y / (depth along the boresight); minimum depth, m
flat out float identity;
flat out Light light;
#ifdef BOULDERS
flat out float brightness;
#endif
noperspective out vec3 ray;
#ifndef FACES
flat out vec4 turn_and_scale;
flat out float height;
#endif
#endif
#if defined(FACES) && defined(SHADOW)
noperspective out vec2 place;
#endif

vec3 turned(vec2 turn, vec3 v) {
    return vec3(turn.x * v.x + turn.y * v.y, turn.x * v.y - turn.y * v.x, v.z);
}

void main() {
#ifdef SHADOW
    vec2 whole = map_size;
#else
    vec2 whole = image;
#endif
    gl_Position = vec4(2.0 * corner / whole - 1.0, 0.0, 1.0);
    int which = int(number);
    ivec2 at = ivec2((which % 1024) * 3, which / 1024);
    vec4 one = texelFetch(rocks, at, 0);
    vec4 two = texelFetch(rocks, at + ivec2(1, 0), 0);
    vec4 three = texelFetch(rocks, at + ivec2(2, 0), 0);
    int shape = int(three.r);
    vec3 centre = one.xyz - eye.xyz;
    vec3 scale = vec3(one.w, two.xy);
    vec2 turn = two.zw;
#ifdef SHADOW
    // Rays from the Sun descend, each from its position at the height of the rock's base.
    vec3 way = vec3(-lean, -1.0);
    vec2 level = map_corner + mat2(from_map.xy, from_map.zw) * corner + lean * centre.z - centre.xy;
    depth = vec2(heights.x - centre.z, 1.0) / (heights.x - heights.y);
#else
    vec3 way = pixel_ray(corner);
    depth = vec3(clip.y, clip.x * clip.y, clip.x * (clip.y - clip.x)) / (clip.y - clip.x);
    identity = number + 2.0;
    light = given_light();
#ifdef BOULDERS
    brightness = three.g;
#endif
    ray = way;
#endif
#ifdef FACES
    for (int k = 0; k < FACES; k++) {
        vec4 plane = planes[shape * MOST + k];
        vec3 n = plane.xyz / scale;
        n = vec3(turn.x * n.x - turn.y * n.y, turn.y * n.x + turn.x * n.y, n.z);
#ifdef SHADOW
        // The height at which a ray crosses the plane is linear in its position.
        float speed = dot(n, way);
        if (abs(speed) < 1e-9) speed = 1e-9;
        face[k] = vec4(-n.xy, plane.w, speed) / abs(speed);
        if (speed < 0.0) face[k].xyz = -face[k].xyz;
#else
        face[k] = vec4(n, plane.w + dot(n, centre));
#endif
    }
#ifdef SHADOW
    place = level;
#endif
#else
#ifdef SHADOW
    moving_part = turned(turn, vec3(level, 0.0)) / scale;
    fixed_part = turned(turn, way) / scale;
#else
    moving_part = turned(turn, way) / scale;
    fixed_part = turned(turn, -centre) / scale;
    turn_and_scale = vec4(turn, scale.xy);
    height = scale.z;
#endif
#endif
}
