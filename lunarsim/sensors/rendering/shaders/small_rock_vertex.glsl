// A pixel of a rock that covers only a few pixels; it is shaded here, once.
in vec3 at;                // pixel, and depth along the boresight of the hit, m
in vec4 stone;             // normal, and index of the rock
#ifdef BOULDERS
uniform sampler2D rocks;
#endif
flat out float depth;
flat out float shade;
#ifdef TRUTH
flat out vec3 normal;
flat out vec2 range_and_number;
#endif

void main() {
    gl_Position = vec4((2.0 * at.xy + 1.0) / image - 1.0, 0.0, 1.0);
    gl_PointSize = 1.0;
    depth = (clip.y - clip.x * clip.y / at.z) / (clip.y - clip.x);
    vec3 rel = at.z * pixel_ray(at.xy + 0.5);
#ifdef BOULDERS
    int which = int(stone.w);
    float brightness = texelFetch(rocks, ivec2((which % 1024) * 3 + 2, which / 1024), 0).g;
#endif
    shade = STONE(given_light(), rel, stone.xyz);
#ifdef TRUTH
    normal = stone.xyz;
    range_and_number = vec2(length(rel), stone.w + 2.0);
#endif
}
