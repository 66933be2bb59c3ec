// Depths of the blocks about each, along one axis.
//
// What is far must be high to reach a point with its penumbra: the depth by which blocks are compared
// grows with their distance. The first of a block is that depth; the third, what it grew from.
uniform sampler2D bounds;
uniform ivec4 spread;        // last column and row, and how far in blocks
uniform float growth;        // of depth for each block
layout(location = 0) out vec4 bound;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    ivec2 step = spread.z > 0 ? ivec2(1, 0) : ivec2(0, 1);
    int far = max(spread.z, spread.w);
    vec4 found = vec4(1e30, 0.0, 1.0, 0.0);
    for (int k = -far; k <= far; k++) {
        vec3 depth = texelFetch(bounds, clamp(here + k * step, ivec2(0), spread.xy), 0).rgb;
        depth.x += growth * float(max(abs(k) - 1, 0));
        if (depth.x < found.x) found.xz = depth.xz;
        found.y = max(found.y, depth.y);
    }
    bound = found;
}
