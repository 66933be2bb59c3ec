// Least and greatest depth of the blocks about each, along one axis.
uniform sampler2D bounds;
uniform ivec4 spread;        // last column and row, and how far in blocks
layout(location = 0) out vec2 bound;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    ivec2 step = spread.z > 0 ? ivec2(1, 0) : ivec2(0, 1);
    int far = max(spread.z, spread.w);
    vec2 found = vec2(1.0, 0.0);
    for (int k = -far; k <= far; k++) {
        vec2 depth = texelFetch(bounds, clamp(here + k * step, ivec2(0), spread.xy), 0).rg;
        found = vec2(min(found.x, depth.x), max(found.y, depth.y));
    }
    bound = found;
}
