// The picture, from the depth and the rocks that were drawn first: each pixel is shaded once.
uniform sampler2D depths;
uniform sampler2D stones;    // normal and number + 1 of the rock in a pixel
uniform sampler2D slopes;    // gradients of the two triangles of each cell, side by side
uniform ivec2 size;          // columns and rows of the relief
uniform ivec2 eye_cell;      // cell of the camera
uniform vec2 eye_in_cell;    // and its place in it
uniform float posting;

#ifdef TRUTH
layout(location = 0) out vec4 grey_and_normal;
layout(location = 1) out vec2 range_and_id;   // identity + 2; 0 is the sky
#else
layout(location = 0) out float grey;
#endif

vec3 relief_normal(vec3 rel) {
    vec2 at = rel.xy / posting + eye_in_cell;
    vec2 cell = floor(at);
    vec2 inside = at - cell;
    ivec2 place = clamp(ivec2(cell) + eye_cell, ivec2(0), size - 2);
    place.x = 2 * place.x + (inside.x >= inside.y ? 0 : 1);
    return normalize(vec3(-texelFetch(slopes, place, 0).rg, 1.0));
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float depth = texelFetch(depths, pixel, 0).r;
    if (depth == 1.0) discard;
    vec3 rel = view_depth(depth) * pixel_ray();
    vec4 stone = texelFetch(stones, pixel, 0);
    vec3 normal = stone.w > 0.0 ? stone.xyz : relief_normal(rel);
#ifdef TRUTH
    grey_and_normal = vec4(radiance(rel, normal), normal);
    range_and_id = vec2(length(rel), stone.w + 1.0);
#else
    grey = radiance(rel, normal);
#endif
}
